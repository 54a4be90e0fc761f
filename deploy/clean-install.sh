#!/bin/sh
# Try the installation in a clean Debian 12 without a network: as root
#     sh deploy/clean-install.sh [--arch aarch64] [--compiler] [--replay LOG] WHEELHOUSE
# WHEELHOUSE is a folder that deploy/wheelhouse.sh made for that architecture and Python 3.11. Makes the Debian by
# debootstrap, with Python alone or with gcc too, below TMPDIR (1 GB); MIRROR names the source of its packages. Installs
# by deploy/install.sh, checks as the user 'nobody', starts and ends the service, and removes everything. For the other
# architecture qemu-user-static has to be registered with the kernel (binfmt_misc). Fails at the first step that does.
# --replay: run this checkout's tests of the kernels there too, replay LOG, and print checksums of its results, to be
# compared with those of another architecture; WHEELHOUSE then needs --with 'auv-mcm[bench]' --with pytest --with
# hypothesis.
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
arch=$(uname -m) include=python3,python3-venv wheelhouse= log=

fail() {
    echo "clean-install: $*" >&2
    exit 1
}

while [ $# -gt 0 ]; do
    case $1 in
    --arch | --replay)
        [ $# -gt 1 ] || fail "$1 wants a value"
        case $1 in
        --arch) arch=$2 ;;
        --replay) log=$2 ;;
        esac
        shift
        ;;
    --compiler) include=$include,gcc,libc6-dev ;;
    -*) fail "$1 is not an option: --arch ARCH, --compiler, --replay LOG" ;;
    *) wheelhouse=$1 ;;
    esac
    shift
done
case $arch in
x86_64) debian=amd64 ;;
aarch64) debian=arm64 ;;
*) fail "--arch $arch: give x86_64 or aarch64" ;;
esac
[ -f "$wheelhouse/deploy/install.sh" ] ||
    fail "name a folder that sh deploy/wheelhouse.sh --arch $arch --python 3.11 made"
[ -z "$log" ] || [ -f "$log" ] || fail "there is no log $log"
[ "$(id -u)" = 0 ] || fail "run it as root: debootstrap and chroot need it"
command -v debootstrap >/dev/null || fail "no debootstrap: apt-get install debootstrap"

root=$(mktemp -d)
trap 'rm -rf --one-file-system "$root"' EXIT
chmod 755 "$root"
echo "clean-install: Debian for $arch with $include"
debootstrap --arch="$debian" --variant=minbase --include="$include" bookworm "$root" \
    "${MIRROR:-http://deb.debian.org/debian}" >"$root.log" || fail "debootstrap failed: see $root.log"
rm -f "$root.log"
cp -R "$wheelhouse" "$root/wheelhouse"

inside() { # COMMAND...: without a network
    # shellcheck disable=SC2016 # expanded by the inner shell
    unshare --net --mount --pid --fork sh -euc 'mount -t proc proc "$0/proc"
        mount -t tmpfs tmpfs "$0/dev/shm"
        exec chroot "$0" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/tmp LANG=C.UTF-8 "$@"' "$root" "$@"
}

if [ -n "$log" ]; then
    inside sh /wheelhouse/deploy/install.sh --with 'auv-mcm[bench]' --with pytest --with hypothesis
else
    inside sh /wheelhouse/deploy/install.sh
fi
program=/opt/auv-mcm/current/bin/auv-mcm
echo "clean-install: check"
inside runuser -u nobody -- sh -c "cd /tmp && $program check"
echo "clean-install: start, and SIGTERM after 10 s"
inside runuser -u nobody -- sh -euc "cd /tmp; $program run --example >vehicle.yaml
    timeout --signal=TERM --preserve-status 10 $program run --config vehicle.yaml
    $program status || true; test -f auv-mcm-out/latest/summary.json"
if [ -n "$log" ]; then
    echo "clean-install: tests of the kernels, and replay of $(basename "$log")"
    mkdir "$root/checkout"
    cp -R "$here/tests" "$here/pyproject.toml" "$root/checkout"
    cp "$log" "$root/checkout/log.xtf"
    inside sh -euc "cd /checkout
        /opt/auv-mcm/current/bin/python -m pytest --quiet -p no:cacheprovider tests/auv_mcm/test_kernels.py \
            tests/auv_mcm/*/test_*kernel*.py tests/auv_mcm/classify/test_likelihood.py
        $program replay log.xtf --out results >/dev/null
        cd results && sha256sum *.geojson *.csv *.kml"
fi
echo "clean-install: done"
