#!/bin/sh
# Everything that must hold before a change goes in: style, types, tests, and a replay of recorded data where it is at
# hand. Needs Python 3.11 or later; a C compiler is used if there is one.
set -eu
cd "$(dirname "$0")/.."
unset PYTHONDONTWRITEBYTECODE # each of hundreds of processes would compile all that it imports
sh deploy/venv.sh bench dev docs

say() {
    echo "test: $*"
}

say "ruff"
.venv/bin/ruff check .
.venv/bin/ruff format --check .
beside=$(mktemp -d)
mypy= hil=
trap 'kill $mypy $hil 2>/dev/null || true; rm -rf "$beside"' EXIT
say "mypy and hardware in the loop, beside the other tests: scenarios mostly wait"
.venv/bin/mypy >"$beside/mypy" 2>&1 &
mypy=$!
.venv/bin/python -m pytest tests/hil --numprocesses 2 --dist load --maxschedchunk 1 >"$beside/hil" 2>&1 &
hil=$!
say "pytest, three files at a time: two cores, and tests that wait for a port"
.venv/bin/python -m pytest tests --ignore tests/hil --ignore tests/studies --numprocesses 3 --dist loadfile
say "mypy has found"
wait "$mypy" || { cat "$beside/mypy"; exit 1; }
cat "$beside/mypy"
say "hardware in the loop has found"
wait "$hil" || { cat "$beside/hil"; exit 1; }
cat "$beside/hil"
say "documentation, warnings are errors"
sh deploy/site.sh
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
