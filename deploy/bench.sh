#!/bin/sh
# Measure this version's run time and error, say what moved beyond noise since the version before, and keep the result:
# sh deploy/bench.sh, on an idle computer, some minutes. Results of all versions: auv_mcm/docs/benchmarks/, a file each
# of the chain, and in stages/ of every stage. The site makes a table of versions of them.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench

history=auv_mcm/docs/benchmarks
version=$(.venv/bin/auv-mcm --version | cut -d ' ' -f 2)
mkdir -p "$history/stages"

# Prints the newest version but this one that FOLDER has results of.
before() { # FOLDER
    find "$1" -maxdepth 1 -name '*.json' | sed 's|.*/||; s|\.json$||' | sort -V | grep -vx "$version" | tail -n 1
}

last=$(before "$history")
# The same missions every time: results of other missions cannot be compared.
set -- bench chain --scenes flat,mixed --seeds 1 --repeat 3 --knobs "" --json "$history/$version.json"
[ -z "$last" ] || set -- "$@" --compare "$history/$last.json"
.venv/bin/auv-mcm "$@"

last=$(before "$history/stages")
.venv/bin/python -m pip install --quiet scikit-image bluerobotics-ping || echo "bench: some alternatives are left out"
set -- bench all --json "$history/stages/$version.json"
[ -z "$last" ] || set -- "$@" --compare "$history/stages/$last.json"
.venv/bin/auv-mcm "$@"
echo "bench: kept as $history/$version.json"
