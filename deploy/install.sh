#!/bin/sh
# Install auv-mcm on a vehicle, from a folder that deploy/wheelhouse.sh made, without a network: as root
#     sh deploy/install.sh [--root DIR] [--with PACKAGE] [--keep-days N] [--sum SHA256]
#                                                                           install this version, or upgrade to it
#     sh deploy/install.sh --rollback [--root DIR]                          go back to the version before
# --root: install below DIR instead, as for an image; then nothing is started and no user is made. --with: install a
# package with a driver too, whose wheel lies in wheels/; more than once for several. --keep-days: remove sessions that
# were neither written nor read for N days. --sum: the checksum that deploy/wheelhouse.sh printed, brought by another
# way than the folder; without it wheels are only held against the list that lies beside them. PYTHON names the
# interpreter, default python3. Each version gets a folder of its own below /opt/auv-mcm; 'current' points to the one
# that runs, 'previous' to the one before. Configuration, results and changed rules of udev are left as they are.
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
root= keep_days= rollback= with= sum=

fail() {
    echo "install: $*" >&2
    exit 1
}

while [ $# -gt 0 ]; do
    case $1 in
    --rollback) rollback=yes ;;
    --root | --with | --keep-days | --sum)
        [ $# -gt 1 ] || fail "$1 wants a value"
        case $1 in
        --root) root=$2 ;;
        --with) with="$with $2" ;;
        --keep-days) keep_days=$2 ;;
        --sum) sum=$2 ;;
        esac
        shift
        ;;
    *) fail "$1 is not an option: --root DIR, --with PACKAGE, --keep-days N, --sum SHA256, --rollback" ;;
    esac
    shift
done
case $keep_days in *[!0-9]*) fail "--keep-days $keep_days: give a number of days" ;; esac
[ -n "$root" ] || [ "$(id -u)" = 0 ] || fail "run it as root, e.g. by sudo, or install below a folder: --root DIR"
case $root in "" | /*) ;; *) root=$PWD/$root ;; esac
prefix=$root/opt/auv-mcm
live=
if [ -z "$root" ] && [ -d /run/systemd/system ]; then live=yes; fi

point() { # LINK VERSION: in one step, so that a power cut leaves the old one or the new one
    ln -sfn "versions/$2" "$prefix/.$1.new"
    mv -T "$prefix/.$1.new" "$prefix/$1"
}

restart() {
    if [ -n "$live" ]; then systemctl try-restart auv-mcm.service; fi
}

if [ -n "$rollback" ]; then
    now=$(basename "$(readlink "$prefix/current" || true)")
    before=$(basename "$(readlink "$prefix/previous" || true)")
    [ -x "$prefix/versions/$before/bin/auv-mcm" ] || fail "there is no version before this one in $prefix"
    point current "$before"
    point previous "$now"
    restart
    echo "install: back at $before; $now is kept"
    exit 0
fi

python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null ||
    fail "$python is not Python 3.11 or later. On Debian or Ubuntu: apt-get install python3 python3-venv"
"$python" -c 'import ensurepip, venv' 2>/dev/null ||
    fail "$python cannot make virtual environments. On Debian or Ubuntu: apt-get install python3-venv"
interpreter=$("$python" -c 'import os, sys; print(os.path.realpath(sys.executable))')
case $interpreter in
/home/* | /root/* | /run/user/*)
    fail "$interpreter lies in a home folder, which the unit hides from the service:" \
        "PYTHON=/usr/bin/python3 sh deploy/install.sh takes the system's"
    ;;
esac
set -- "$here"/wheels/auv_mcm-*.whl
[ -f "$1" ] ||
    fail "$here/wheels holds no wheel of auv-mcm: where there is a network, sh deploy/wheelhouse.sh makes such a folder"
list=$here/wheels.sha256
[ -f "$list" ] || fail "$list is missing: copy the whole folder that deploy/wheelhouse.sh made"
[ -z "$sum" ] || [ "$(sha256sum <"$list" | cut -d ' ' -f 1)" = "$sum" ] ||
    fail "$list is not the one with --sum $sum: fetch the folder again"
for wheel in "$here"/wheels/*; do
    grep -q "^[0-9a-f]\{64\}  $(basename "$wheel" | sed 's/[.[*^$\\]/\\&/g')\$" "$list" ||
        fail "$wheel is not in $list. If you put it there: (cd $here/wheels && sha256sum $(basename "$wheel")) >>$list"
done
(cd "$here/wheels" && sha256sum --check --strict --quiet "$list") ||
    fail "a wheel is damaged or was changed: fetch the folder again"
number=$(basename "$1" | cut -d - -f 2)
# Two builds of one version number are two versions, as are two sets of packages.
version=$number-$({ cat "$1" && ls "$here/wheels" && echo "$with"; } | cksum | cut -d ' ' -f 1)
place=$prefix/versions/$version
if [ "$(readlink "$prefix/current" || true)" = "versions/$version" ]; then
    echo "install: $version is installed already"
else
    echo "install: $version into $place"
    rm -rf "$place" # of an installation that was cut off
    mkdir -p "$prefix/versions"
    "$python" -m venv "$place"
    "$place/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --no-index \
        --find-links "$here/wheels" auv-mcm $with ||
        fail "packages are missing or are for another Python or computer than this one" \
        "($("$python" -c 'import platform; print(platform.python_version(), platform.machine())'))"
    kernels=$("$place/bin/python" -c 'from auv_mcm import kernels; print(kernels.backend(), kernels.loaded().reason)')
    case $kernels in
    c*) ;;
    *) echo "install: WARNING: numpy does the work of the kernels, many times slower: $kernels" >&2 ;;
    esac
    # A fifth of what packages take serves no vehicle: their tests, pip, what compilers and type checkers read, the
    # second of two backends of zstandard, and bytecode of what is never imported. What is imported needs its bytecode
    # now: the service may not write here.
    "$place/bin/python" -m pip uninstall --quiet --yes setuptools pip 2>/dev/null || true
    packages=$("$place/bin/python" -c 'import sysconfig; print(sysconfig.get_path("platlib"))')
    find "$packages" -type d -name tests -prune -exec rm -rf {} +
    find "$packages" -type f \( -name '*.pyi' -o -name '*.pxd' -o -name '*.h' -o -name '*.a' \) -exec rm -f {} +
    rm -f "$packages"/zstandard/_cffi.*
    "$place/bin/python" -m compileall -q "$packages" || true
    before=$(readlink "$prefix/current" || true)
    [ -z "$before" ] || point previous "$(basename "$before")"
    point current "$version"
fi

put() { # FILE FOLDER NAME
    mkdir -p "$root$2"
    install -m 0644 "$1" "$root$2/$3"
}
put "$here/deploy/systemd/auv-mcm.service" /etc/systemd/system auv-mcm.service
put "$here/deploy/systemd/auv-mcm.sysusers.conf" /etc/sysusers.d auv-mcm.conf
rules=/etc/udev/rules.d/99-auv-mcm.rules
if [ ! -e "$root$rules" ]; then
    put "$here/deploy/udev/99-auv-mcm.rules" /etc/udev/rules.d 99-auv-mcm.rules
elif ! cmp -s "$here/deploy/udev/99-auv-mcm.rules" "$root$rules"; then
    echo "install: $rules differs from deploy/udev/99-auv-mcm.rules and is left as it is"
fi
if [ -n "$keep_days" ]; then
    sed "s/30d/${keep_days}d/" "$here/deploy/systemd/auv-mcm.tmpfiles.conf" >"$place/auv-mcm.tmpfiles.conf"
    put "$place/auv-mcm.tmpfiles.conf" /etc/tmpfiles.d auv-mcm.conf
fi
mkdir -p "$root/etc/auv-mcm"
if [ -n "$live" ]; then
    systemd-sysusers auv-mcm.conf
    # As the unit's StateDirectory makes it, so that a check before the first start finds it.
    install -d -m 0750 -o auvmcm -g auvmcm /var/lib/auv-mcm
    udevadm control --reload && udevadm trigger --subsystem-match=tty --subsystem-match=pps
    systemctl daemon-reload
fi
restart

# The version that runs and the one before stay, so that there is a way back.
for old in "$prefix/versions"/*; do
    case $(basename "$old") in
    "$version" | "$(basename "$(readlink "$prefix/previous" || true)")") ;;
    *) rm -rf "$old" ;;
    esac
done
echo "install: $version is current, $(du -sm "$place" | cut -f 1) MB"
[ -e "$root/etc/auv-mcm/vehicle.yaml" ] ||
    echo "install: next, write /etc/auv-mcm/vehicle.yaml, as deploy/examples shows, and run" \
        "/opt/auv-mcm/current/bin/auv-mcm check --config /etc/auv-mcm/vehicle.yaml"
[ -z "$live" ] || systemctl is-enabled --quiet auv-mcm.service ||
    echo "install: it starts with the vehicle after: systemctl enable --now auv-mcm.service"
