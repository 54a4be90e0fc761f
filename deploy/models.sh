#!/bin/sh
# Makes every file that the payload has learnt again, from seeds alone, in the order in which they depend on each other.
# Each goes into the package as soon as it is made, since those after it are fitted with it. The manifest says of each
# what made it, how long that took, its SHA-256, and whether it is the file of the last commit.
#     sh deploy/models.sh [FOLDER]     (default out-models; a second run goes on where the first was interrupted)
# Takes some seven hours on two cores. Afterwards run `.venv/bin/python -m tests.golden --update`, and the tests.
set -eu
cd "$(dirname "$0")/.."
made=${1:-out-models}
sh deploy/venv.sh bench verifier
mkdir -p "$made"
: >"$made/manifest.txt"

make() { # FILE OR FOLDER OF THE PACKAGE, OPTIONS OF auv-mcm
    place=$1
    shift
    name=$(echo "$place $2" | tr '/ ' '--')
    if [ ! -e "$made/$name" ]; then
        echo "models: $place: auv-mcm $*"
        rm -rf "$made/unfinished"
        started=$(date +%s)
        .venv/bin/auv-mcm "$@" --out "$made/unfinished" >"$made/$name.txt"
        echo "$(($(date +%s) - started)) s by auv-mcm $*" >"$made/$name.how"
        mv "$made/unfinished" "$made/$name"
    fi
    files=$place
    if [ -d "$made/$name" ]; then
        cp "$made/$name"/* "$place"
        files=$(cd "$made/$name" && ls | sed "s|^|$place/|")
    else
        cp "$made/$name" "$place"
    fi
    for file in $files; do
        as=changed
        if git diff --quiet HEAD -- "$file"; then as="as committed"; fi
        digest=$(sha256sum "$file" | cut -d' ' -f1)
        echo "$file: $as, $(cat "$made/$name.how"), SHA-256 $digest" >>"$made/manifest.txt"
    done
}

make auv_mcm/detect/cascade/model.json train --tiles "$made/tiles"
make auv_mcm/classify/mine_odds_contrast.json calibrate odds --detector contrast
make auv_mcm/classify/mine_odds_cascade.json calibrate odds --crowded 3 --drawn 100 --looks "$made/looks-odds"
make auv_mcm/classify calibrate verifier --looks "$made/looks-verifier" # the network, and the odds that weigh it
make auv_mcm/detect/gate.json calibrate gate
make auv_mcm/contacts/background.json calibrate background
make auv_mcm/classify/size_law.json calibrate sizes
make auv_mcm/clearance/detection_performance.json calibrate performance
make auv_mcm/seabed/model.json calibrate seabed
echo "models: $made/manifest.txt"
cat "$made/manifest.txt"
