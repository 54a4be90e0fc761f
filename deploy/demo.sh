#!/bin/sh
# A short mission through virtual serial and CAN ports into the running service, and what its ports recorded replayed;
# then a longer simulated mission through the whole chain, scored. Says in one sentence what was found and where it
# lies, and opens the report where there is a screen.
# Needs Python 3.11 or later; a C compiler is used if there is one. Everything is written below this checkout.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench view

echo "demo: a short mission through virtual ports into the running service"
.venv/bin/auv-mcm hil clean --out out-demo/hil
echo "demo: replaying what its ports recorded"
.venv/bin/auv-mcm replay out-demo/hil/clean/results/latest/recording --out out-demo/ports
echo "demo: flying a longer simulated mission"
.venv/bin/auv-mcm simulate demo --out out-demo/sim
echo "demo: replaying it"
.venv/bin/auv-mcm replay out-demo/sim/mission.xtf --out out-demo/results
echo "demo: comparing the contacts with the truth"
.venv/bin/auv-mcm score out-demo/results/contacts.geojson out-demo/sim/truth.json --json out-demo/score.json > /dev/null

echo
.venv/bin/auv-mcm score out-demo/results/contacts.geojson out-demo/sim/truth.json --brief
echo "reports:        $(pwd)/out-demo/results/report.html"
echo "                $(pwd)/out-demo/ports/report.html"
echo "look and judge: .venv/bin/auv-mcm view out-demo/results --open"
# Where there is a screen, show it.
if [ -n "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ] && command -v xdg-open >/dev/null; then
    xdg-open out-demo/results/report.html >/dev/null 2>&1 || true
fi
