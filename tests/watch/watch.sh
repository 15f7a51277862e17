#!/bin/sh
# Watches a short run in a headless Chromium.
#
#   watch.sh PROGRAM PYTHON [FOLDER]      with FOLDER, screenshots are left there
set -eu
program=$(realpath "$1")
python=$2
here=$(dirname "$(realpath "$0")")
shots=${3:+$(realpath "$3")}
folder=$(mktemp -d)
run=
trap '[ -z "$run" ] || kill -KILL "$run" 2>/dev/null; rm -rf "$folder"' EXIT
cd "$folder"
"$program" run "$here/small.ron" --watch > said 2>&1 &
run=$!
until grep -q 'watch it at' said; do sleep 0.1; kill -0 "$run"; done
url=$(sed -n 's/.*watch it at \(http[^ ]*\).*/\1/p' said)
"$python" "$here/click.py" "$url" ${shots:+"$shots"}
# The pages are closed: the run ends by itself.
wait "$run" || { cat said >&2; exit 1; }
run=
