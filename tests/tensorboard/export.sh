#!/bin/sh
# Runs a small pipeline, exports its curves, and reads them with TensorBoard's own reader.
#
#   export.sh PROGRAM PYTHON
set -eu
program=$(realpath "$1")
python=$2
here=$(dirname "$(realpath "$0")")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"$program" run "$here/../view/small.ron" --quiet > /dev/null
"$program" export tensorboard -o curves
"$python" "$here/read.py" curves
