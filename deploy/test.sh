#!/bin/sh
# Everything that must hold before a change goes in: style, types, tests, and a replay of recorded data where it is at hand.
# Needs Python 3.11 or later; a C compiler is used if there is one.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench dev

say() {
    echo "test: $*"
}

say "ruff"
.venv/bin/ruff check .
.venv/bin/ruff format --check .
say "mypy, beside the tests"
types=$(mktemp)
.venv/bin/mypy >"$types" 2>&1 &
mypy=$!
trap 'kill "$mypy" 2>/dev/null || true; rm -f "$types"' EXIT
say "pytest, three files at a time: two cores, and tests that wait for a port"
.venv/bin/python -m pytest tests --ignore tests/hil --ignore tests/studies --numprocesses 3 --dist loadfile
say "pytest of the hardware in the loop, four scenarios at a time: they mostly wait"
.venv/bin/python -m pytest tests/hil --numprocesses 4 --dist load --maxschedchunk 1
say "mypy has found"
wait "$mypy" || { cat "$types"; exit 1; }
cat "$types"
say "auv-mcm check"
.venv/bin/auv-mcm check

log=../shared/data/sidescan/scotsman-iver2.xtf
if [ -f "$log" ]; then
    say "replay of $log"
    .venv/bin/auv-mcm replay "$log" --out out-test
else
    say "$log is not there: no replay of recorded data"
fi
say "all passed"
