#!/bin/sh
# Make or refresh .venv at the root of this checkout: sh deploy/venv.sh EXTRA... (bench, view, dev, docs)
# Does nothing if what is installed is what this checkout asks for. PYTHON names the interpreter, default python3; VENV
# the folder.
set -eu
cd "$(dirname "$0")/.."
venv=${VENV:-.venv}

fail() {
    echo "deploy: $*" >&2
    exit 1
}

recent() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null
}

if [ -n "${PYTHON:-}" ]; then
    recent "$PYTHON" || fail "PYTHON=$PYTHON is no Python 3.11 or later."
else
    for PYTHON in python3 python3.14 python3.13 python3.12 python3.11 none; do
        if [ "$PYTHON" = none ] || recent "$PYTHON"; then break; fi
    done
    [ "$PYTHON" != none ] ||
        fail "Python 3.11 or later is needed. On Debian or Ubuntu: sudo apt-get install python3 python3-venv" \
            "(or set PYTHON=/path/to/python)."
fi

version=$("$PYTHON" -c 'import platform; print(platform.python_version())')
if [ "$("$venv/bin/python" -c 'import platform; print(platform.python_version())' 2>/dev/null)" != "$version" ]; then
    "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null ||
        fail "Python $version cannot make virtual environments. On Debian or Ubuntu:" \
            "sudo apt-get install python3-venv (or python${version%.*}-venv)."
    echo "deploy: making $venv with Python $version"
    "$PYTHON" -m venv --clear "$venv"
fi

asked=$(cat pyproject.toml setup.py auv_mcm/kernels/*.[ch] sim_replay/simulator/*.[ch] | cksum)
missing=
for extra in "$@"; do
    [ "$(cat "$venv/installed-$extra" 2>/dev/null)" = "$asked" ] || missing=yes
done
if [ -n "$missing" ]; then
    extras=$(echo "$*" | tr ' ' ',')
    echo "deploy: installing auv-mcm[$extras] into $venv (a few minutes the first time)"
    command -v "${CC:-cc}" >/dev/null ||
        echo "deploy: no C compiler found: numpy will do the work of the C kernels, more slowly"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --editable ".[$extras]"
    for extra in "$@"; do
        echo "$asked" >"$venv/installed-$extra"
    done
fi
