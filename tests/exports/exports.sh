#!/bin/sh
# Exports a small scene in every layout, as splats, frames, cameras, moving pictures and latents, and has libraries that share no code with srnerf-dag read them.
#
#   exports.sh PROGRAM PYTHON      the Python has pycolmap, plyfile, pygltflib, usd-core, OpenImageIO, safetensors,
#                                  numpy and pillow; films are tried where there is an ffmpeg
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
path=out/small/fly/images
for numbers in half float; do
    for compression in zip piz dwaa; do
        "$program" export exr $path --numbers $numbers --compression $compression -o $numbers-$compression/fly.####.exr
    done
done
"$program" export exr $path --parts --first 1001 --fps 23.976 -o parts/fly.####.exr
for ending in usda gltf glb; do
    "$program" export cameras $path -o path.$ending
    "$program" export cameras $train -o views.$ending
done
"$program" export video $path -o fly.webp --fps 12
if command -v ffmpeg >/dev/null; then
    "$program" export video $path -o fly.mp4
    "$program" export video $path -o fly.webm --show depth
else
    echo 'there is no ffmpeg: films are not tried'
fi
"$program" export latents out/small/encode/latents --comfyui -o latents
"$python" "$here/check.py" $train $test
"$python" "$here/splats.py"
"$python" "$here/frames.py" $path
"$python" "$here/cameras.py" $path $train
"$python" "$here/latents.py" out/small/encode/latents
