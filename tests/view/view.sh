#!/bin/sh
# Makes a small field and one that goes on from it, and flies through their page in a headless Chromium and, where there is
# one, a headless Firefox.
#
#   view.sh PROGRAM PYTHON [FOLDER]      with FOLDER, screenshots are left there
set -eu
program=$(realpath "$1")
python=$2
here=$(dirname "$(realpath "$0")")
shots=${3:+$(realpath "$3")}
folder=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill -INT "$server" 2>/dev/null; rm -rf "$folder"' EXIT
cd "$folder"
"$program" run "$here/small.ron" --quiet > /dev/null
"$program" view --json > said &
server=$!
until [ -s said ]; do sleep 0.1; kill -0 "$server"; done
"$python" "$here/click.py" said ${shots:+"$shots"}
if command -v firefox-esr > /dev/null; then
    "$python" "$here/firefox.py" said ${shots:+"$shots"}
fi
# What was recorded in the browser is rendered by a pipeline.
"$program" run "$here/flight.ron" --quiet > /dev/null
kill -INT "$server"
wait "$server"
server=
