#!/bin/sh
# Run tests with the C kernels built under the address and undefined-behaviour sanitizers, in a copy of this checkout:
#     sh deploy/sanitize.sh [TEST...]      (default: the rooms that call kernels, some fifteen minutes on a core)
# Stops at the first access outside an array and the first undefined operation, with the line of C. Needs gcc.
set -eu
cd "$(dirname "$0")/.."
sh deploy/venv.sh bench dev
[ $# -gt 0 ] || set -- tests/auv_mcm/test_kernels.py tests/auv_mcm/waterfall tests/auv_mcm/detect \
    tests/auv_mcm/confirm tests/auv_mcm/classify tests/auv_mcm/solids tests/auv_mcm/seabed \
    tests/stability tests/sim_replay/simulator

python=$PWD/.venv/bin/python
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
git ls-files -z | xargs -0 tar -cf - | tar -xf - -C "$copy"
cd "$copy"
for library in auv_mcm/kernels/_kernels sim_replay/simulator/_simulator; do
    gcc -shared -fPIC -std=c99 -O1 -g -fno-omit-frame-pointer -ffp-contract=off -fsanitize=address,undefined \
        -fno-sanitize-recover=undefined -o "$library.abi3.so" "${library%/*}"/*.c -lm
done
# Python's own leaks are none of ours; its allocator would hide arrays from the sanitizer.
env PYTHONPATH="$copy" PYTHONMALLOC=malloc ASAN_OPTIONS=detect_leaks=0:abort_on_error=1 \
    LD_PRELOAD="$(gcc -print-file-name=libasan.so) $(gcc -print-file-name=libubsan.so)" \
    "$python" -m pytest --quiet --capture=sys -p no:cacheprovider "$@"
