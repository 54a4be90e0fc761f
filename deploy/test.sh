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
say "mypy"
.venv/bin/mypy
say "pytest, two files at a time"
.venv/bin/python -m pytest tests --ignore tests/hil --ignore tests/studies --numprocesses 2 --dist loadfile
say "pytest of the loop in hardware, which needs the computer to itself"
.venv/bin/python -m pytest tests/hil
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
