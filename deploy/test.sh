#!/bin/sh
# Everything that must hold before a change goes in: style, types, tests, and a replay of recorded data where it is at
# hand. Every part runs and prints its result, whatever fails; the last line names the parts that failed.
# Needs Python 3.11 or later; a C compiler is used if there is one.
set -eu
cd "$(dirname "$0")/.."
unset PYTHONDONTWRITEBYTECODE # each of hundreds of processes would compile all that it imports
sh deploy/venv.sh bench view cluster dev docs

say() {
    echo "test: $*"
}

as_a_user() {
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
}

failed=
part() { # NAME COMMAND: runs a part, and remembers it if it fails
    name=$1
    shift
    say "$name"
    "$@" || failed="$failed $name,"
}

collected() { # prints only what fails
    .venv/bin/python -m pytest tests --collect-only --quiet >"$beside/collected" 2>&1 || {
        cat "$beside/collected"
        return 1
    }
}

shown() { # NAME PROCESS: waits for what runs beside the tests, and shows what it printed
    wait "$2"
    code=$?
    cat "$beside/$1"
    return "$code"
}

part "style" .venv/bin/ruff check .
part "format" .venv/bin/ruff format --check .
beside=$(mktemp -d)
types= loop= user=
trap 'kill $types $loop $user 2>/dev/null || true; rm -rf "$beside"' EXIT
say "types, hardware in the loop, documentation and a replay, beside the other tests: scenarios mostly wait"
nice -n 10 .venv/bin/mypy >"$beside/types" 2>&1 &
types=$!
# compiles tests and packages once: 20 s of processor time, which each of five workers would take at the same moment
part "collection" collected
.venv/bin/python -m pytest tests/hil --numprocesses 2 --dist load --maxschedchunk 1 >"$beside/loop" 2>&1 &
loop=$!
as_a_user >"$beside/user" 2>&1 &
user=$!
# three files at a time: two cores, and tests that wait for a port; behind the service, which runs in real time. In the
# order of their names: by default the files with the fewest tests are last, and those of whole missions take longest
part "tests" nice -n 10 .venv/bin/python -m pytest tests --ignore tests/hil --numprocesses 3 --dist loadfile \
    --no-loadscope-reorder
part "types" shown types "$types"
part "hardware in the loop" shown loop "$loop"
part "documentation and replay" shown user "$user"
if [ -n "$failed" ]; then
    say "failed:${failed%,}"
    exit 1
fi
say "all passed"
