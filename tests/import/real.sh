#!/bin/sh
# Has a real COLMAP (pycolmap, and Debian's `colmap` where there is one) find where photos were taken, and plans what follows.
#
#   real.sh PROGRAM PYTHON PHOTOS      PHOTOS: a folder of photos without poses
set -eu
program=$(realpath "$1")
python=$2
photos=$(realpath "$3")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
try() {
    "$program" import "$photos" "$@"
    "$program" plan ./*.ron > /dev/null
    rm -r ./*.ron ./*_posed
}
try --python "$python"
if command -v colmap > /dev/null; then
    try --colmap colmap
fi
