#!/bin/sh
# Run the quick tests under every Python from 3.11 on that is installed here, each in an environment of its own:
#     sh deploy/matrix.sh [TEST...]
# PYTHONS names the interpreters instead. Prints the versions that were not found; fails if a test fails, or if no
# version was found.
set -eu
cd "$(dirname "$0")/.."
[ $# -gt 0 ] || set -- tests/auv_mcm tests/drivers tests/accuracy tests/test_import_graph.py

found= missing= failed=
for version in 3.11 3.12 3.13 3.14; do
    python=
    pyenv=${PYENV_ROOT:-$HOME/.pyenv}/versions
    for candidate in ${PYTHONS:-"python$version" "$pyenv/$version".*/bin/python python3}; do
        if [ "$("$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)" = "$version" ]; then
            python=$candidate
            break
        fi
    done
    if [ -z "$python" ]; then
        missing="$missing $version"
        continue
    fi
    echo "matrix: Python $version"
    found="$found $version"
    place=.venv-$version
    PYTHON=$python VENV=$place sh deploy/venv.sh bench view cluster dev docs &&
        "$place/bin/python" -m pytest "$@" --quiet ||
        failed="$failed $version"
done
echo "matrix: ran under${found:- none}; not installed:${missing:- none}; failed:${failed:- none}"
[ -n "$found" ] && [ -z "$failed" ]
