#!/bin/sh
# Fly a small simulated mission, replay it through the whole chain, score what it found, and say where the report is.
# Needs Python 3.11 or later; a C compiler is used if there is one. Everything is written below this checkout.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench

echo "demo: flying a simulated mission"
.venv/bin/auv-mcm simulate demo --out out-demo/sim
echo "demo: replaying it"
.venv/bin/auv-mcm replay out-demo/sim/mission.xtf --out out-demo/results
echo "demo: comparing the contacts with the truth"
.venv/bin/auv-mcm score out-demo/results/contacts.geojson out-demo/sim/truth.json

echo
echo "Open the report in a browser: $(pwd)/out-demo/results/report.html"
