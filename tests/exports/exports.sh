#!/bin/sh
# Exports a small scene in every layout and as splats, and has libraries that share no code with srnerf-dag read them.
#
#   exports.sh PROGRAM PYTHON      the Python has pycolmap, plyfile, pygltflib, usd-core, numpy and pillow
set -eu
program=$(realpath "$1")
python=$(realpath -s "$2")
here=$(dirname "$(realpath "$0")")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"$program" run "$here/small.ron" --quiet >/dev/null
train=out/small/up/images
test=out/small/scene/test
field=out/small/fit/field
for layout in nerfstudio brush colmap instant-ngp; do
    "$program" export $layout $train $test --points $field -o $layout
done
for ending in ply glb usda; do
    "$program" export splat $field --views $train --test $test --steps 20 --most 3000 -o splats.$ending
done
"$python" "$here/check.py" $train $test
"$python" "$here/splats.py"
