#!/bin/sh
# Make a small synthetic mission, replay it through the whole chain, and say where the report is.
# Needs Python 3.11 or later; a C compiler is used if there is one. Everything is written below this checkout.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench

mkdir -p out-demo
echo "demo: making a synthetic mission"
.venv/bin/python -m sim_replay.synthetic --out out-demo/mission.xtf
echo "demo: replaying it"
.venv/bin/auv-mcm replay out-demo/mission.xtf --out out-demo/results

echo
echo "Open the report in a browser: $(pwd)/out-demo/results/report.html"
