#!/bin/sh
# Make a folder that installs auv-mcm without a network: sh deploy/wheelhouse.sh [FOLDER]
# It holds this checkout's wheel with compiled kernels, the wheels of all packages that the base needs, and
# deploy/install.sh with what that installs. For computers of this architecture with this minor version of Python, which
# PYTHON names, default python3. Needs a network and a C compiler here, and neither on the vehicle.
set -eu
cd "$(dirname "$0")/.."
out=${1:-out-wheelhouse}
python=${PYTHON:-python3}

fail() {
    echo "wheelhouse: $*" >&2
    exit 1
}

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null ||
    fail "$python is not Python 3.11 or later"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/venv" || fail "no virtual environment: sudo apt-get install python3-venv"

# From a copy: setuptools leaves its build folder behind, and an old one would go into the wheel.
mkdir "$work/source"
cp -R pyproject.toml setup.py README.md LICENSE auv_mcm drivers sim_replay "$work/source"
find "$work/source" \( -name __pycache__ -o -name '*.so' \) -prune -exec rm -rf {} +
echo "wheelhouse: fetching and building wheels"
"$work/venv/bin/python" -m pip wheel --quiet --disable-pip-version-check --wheel-dir "$work/wheels" "$work/source"
"$work/venv/bin/python" -m zipfile --list "$work"/wheels/auv_mcm-*.whl |
    grep 'auv_mcm/kernels/_kernels.*\.so' >/dev/null ||
    fail "the kernels were not compiled: install a C compiler, e.g. sudo apt-get install gcc python3-dev." \
        "On the vehicle numpy would do their work, many times slower"

rm -rf "$out"
mkdir -p "$out/deploy"
mv "$work/wheels" "$out/wheels"
cp -R deploy/install.sh deploy/systemd deploy/udev deploy/can deploy/examples deploy/auv_mcm.dbc "$out/deploy"
echo "wheelhouse: $out, $(du -sm "$out" | cut -f 1) MB. Copy it to the vehicle; there, as root: sh deploy/install.sh"
