#!/bin/sh
# Build the documentation as a site into out-site/, with warnings as errors. Nothing is fetched but what pip installs
# the first time.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench view cluster dev docs
.venv/bin/python -m mkdocs build --strict --config-file deploy/site/mkdocs.yml
echo "site: open $(pwd)/out-site/index.html"
