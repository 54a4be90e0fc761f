#!/bin/sh
# Measure this version's run time and error, say what moved beyond noise since the version before, and keep the result:
# sh deploy/bench.sh, on an idle computer, some minutes. Results of all versions: auv_mcm/docs/benchmarks/, a file each.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench

history=auv_mcm/docs/benchmarks
version=$(.venv/bin/auv-mcm --version | cut -d ' ' -f 2)
last=$(ls "$history" 2>/dev/null | sed 's/\.json$//' | sort -V | grep -vx "$version" | tail -n 1)
mkdir -p "$history"
# The same missions every time: results of other missions cannot be compared.
set -- bench chain --scenes flat,mixed --seeds 1 --repeat 3 --knobs "" --json "$history/$version.json"
[ -z "$last" ] || set -- "$@" --compare "$history/$last.json"
.venv/bin/auv-mcm "$@"
echo "bench: kept as $history/$version.json"
