#!/bin/sh
# A short mission through virtual serial and CAN ports into the running service, and what its ports recorded replayed;
# then a longer simulated mission through the whole chain, scored. Says where the reports are.
# Needs Python 3.11 or later; a C compiler is used if there is one. Everything is written below this checkout.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench

echo "demo: a short mission through virtual ports into the running service"
.venv/bin/auv-mcm hil clean --out out-demo/hil
echo "demo: replaying what its ports recorded"
.venv/bin/auv-mcm replay out-demo/hil/clean/results/latest/recording --out out-demo/ports
echo "demo: flying a longer simulated mission"
.venv/bin/auv-mcm simulate demo --out out-demo/sim
echo "demo: replaying it"
.venv/bin/auv-mcm replay out-demo/sim/mission.xtf --out out-demo/results
echo "demo: comparing the contacts with the truth"
.venv/bin/auv-mcm score out-demo/results/contacts.geojson out-demo/sim/truth.json

echo
echo "Open the reports in a browser: $(pwd)/out-demo/ports/report.html"
echo "                               $(pwd)/out-demo/results/report.html"
