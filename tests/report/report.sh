#!/bin/sh
# Runs a small comparison, reports it, and clicks through the report in a headless Chromium.
#
#   report.sh PROGRAM PYTHON [FOLDER]      with FOLDER, screenshots are left there
set -eu
program=$(realpath "$1")
python=$2
here=$(dirname "$(realpath "$0")")
shots=${3:+$(realpath "$3")}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"$program" run "$here/small.ron" --quiet > /dev/null
"$program" report small -o report.html
"$python" "$here/click.py" report.html ${shots:+"$shots"}
