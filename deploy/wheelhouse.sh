#!/bin/sh
# Make a folder that installs auv-mcm without a network:
#     sh deploy/wheelhouse.sh [--arch ARCH] [--python X.Y] [--with PACKAGE] [FOLDER]
# It holds this checkout's wheel with compiled kernels, the wheels of all packages that the base needs, their checksums
# (wheels.sha256) and bill of materials (sbom.cdx.json, CycloneDX), and deploy/install.sh with what that installs. The
# wheel is built twice and has to be the same to the byte; SOURCE_DATE_EPOCH is its time, default that of the last
# commit. --arch: the vehicle's architecture, x86_64 or aarch64, default this computer's; for the other one a cross
# compiler has to be here (Debian: gcc-aarch64-linux-gnu or gcc-x86-64-linux-gnu). --python: its Python, default this
# computer's; the wheel of this checkout serves every one from 3.11 on, those of other packages do not. --with: fetch
# this package too, such as one with a driver, or 'auv-mcm[bench]'; more than once for several. PYTHON names the
# interpreter that builds, default python3. Needs a network and a C compiler here, and neither on the vehicle, which
# needs glibc 2.28 or later (Debian 10, Ubuntu 20.04).
set -eu
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
arch=$(uname -m) release= out= with=

fail() {
    echo "wheelhouse: $*" >&2
    exit 1
}

while [ $# -gt 0 ]; do
    case $1 in
    --arch | --python | --with)
        [ $# -gt 1 ] || fail "$1 wants a value"
        case $1 in
        --arch) arch=$2 ;;
        --python) release=$2 ;;
        --with) with="$with $2" ;;
        esac
        shift
        ;;
    -*) fail "$1 is not an option: --arch ARCH, --python X.Y, --with PACKAGE" ;;
    *) out=$1 ;;
    esac
    shift
done
out=${out:-out-wheelhouse}
case $arch in x86_64 | aarch64) ;; *) fail "--arch $arch: give x86_64 or aarch64" ;; esac
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null ||
    fail "$python is not Python 3.11 or later"
release=${release:-$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')}
case $release in 3.1[1-9]) ;; *) fail "--python $release: give a version from 3.11 on, such as 3.12" ;; esac
if [ "$arch" != "$(uname -m)" ]; then
    CC=$arch-linux-gnu-gcc LDSHARED="$arch-linux-gnu-gcc -shared" _PYTHON_HOST_PLATFORM=linux-$arch
    export CC LDSHARED _PYTHON_HOST_PLATFORM # the last one names the wheel
    command -v "$CC" >/dev/null ||
        fail "no $CC: sudo apt-get install gcc-$(echo "$arch" | tr _ -)-linux-gnu libc6-dev-*-cross"
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/venv" || fail "no virtual environment: sudo apt-get install python3-venv"

# What builds is pinned, and so are times and permissions: whoever builds this checkout gets the same bytes.
# 1980, ZIP's first year
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 315532800)}
export SOURCE_DATE_EPOCH
umask 022
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check --requirement deploy/build-requirements.txt
for build in wheels again; do
    # From a copy: setuptools leaves its build folder behind, and an old one would go into the wheel.
    mkdir "$work/$build-source"
    cp -R pyproject.toml setup.py README.md LICENSE auv_mcm drivers sim_replay "$work/$build-source"
    find "$work/$build-source" \( -name __pycache__ -o -name '*.so' \) -prune -exec rm -rf {} +
    chmod -R u=rwX,go=rX "$work/$build-source"
    echo "wheelhouse: building the wheel for $arch ($build)"
    "$work/venv/bin/python" -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation \
        --wheel-dir "$work/$build" "$work/$build-source"
done
cmp "$work"/wheels/auv_mcm-*.whl "$work"/again/auv_mcm-*.whl ||
    fail "two builds of the wheel differ: this compiler writes the time or its folder into what it makes"
wheel=$(echo "$work"/wheels/auv_mcm-*.whl)
"$work/venv/bin/python" -m zipfile --list "$wheel" | grep 'auv_mcm/kernels/_kernels\.abi3\.so' >/dev/null ||
    fail "the kernels were not compiled: install a C compiler, e.g. sudo apt-get install gcc libc6-dev." \
        "On the vehicle numpy would do their work, many times slower"
"$work/venv/bin/python" -m zipfile --extract "$wheel" "$work/unpacked"
for library in "$work"/unpacked/*/*/*.abi3.so; do
    # The machine in the header of ELF: 62 is x86-64, 183 aarch64.
    case $arch-$(od -An -tu1 -j18 -N1 "$library" | tr -d ' ') in
    x86_64-62 | aarch64-183) ;;
    *) fail "$(basename "$library") was not compiled for $arch" ;;
    esac
done

echo "wheelhouse: fetching packages for Python $release on $arch"
platforms="--platform linux_$arch"
for minor in 28 27 26 25 24 23 22 21 20 19 18 17; do # of several wheels the first that fits is taken
    platforms="$platforms --platform manylinux_2_${minor}_$arch"
done
platforms="$platforms --platform manylinux2014_$arch"
# shellcheck disable=SC2086 # options, one a word
"$work/venv/bin/python" -m pip download --quiet --disable-pip-version-check --only-binary :all: \
    --implementation cp --python-version "$release" $platforms --find-links "$work/wheels" --dest "$work/wheels" \
    "$wheel" $with

rm -rf "$out"
mkdir -p "$out/deploy"
mv "$work/wheels" "$out/wheels"
(cd "$out/wheels" && sha256sum -- *.whl) >"$out/wheels.sha256"
"$work/venv/bin/python" deploy/sbom.py "$out/wheels" >"$out/sbom.cdx.json"
cp -R deploy/install.sh deploy/systemd deploy/udev deploy/can deploy/examples deploy/auv_mcm.dbc "$out/deploy"
echo "wheelhouse: $out for Python $release on $arch, $(du -sm "$out" | cut -f 1) MB. Copy it to the vehicle; there," \
    "as root: sh deploy/install.sh --sum $(sha256sum <"$out/wheels.sha256" | cut -d ' ' -f 1)"
