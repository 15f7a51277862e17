#!/usr/bin/env bash
# Makes the release of this commit twice, in two new folders with nothing built before, and compares the checksums of all its files.
#
#     tests/dist/twice.sh
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for clone in one a-longer-name/two; do
    git clone --quiet . "$folder/$clone"
    env -u CARGO_TARGET_DIR -u MAKEFLAGS -u MFLAGS make --no-print-directory -C "$folder/$clone" dist >/dev/null
    mv "$folder/$clone/target/dist/SHA256SUMS" "$folder/$(basename "$clone").sums"
    rm -rf "${folder:?}/$clone"
done
diff "$folder/one.sums" "$folder/two.sums" || { echo 'two builds differ' >&2; exit 1; }
echo 'two builds are the same release'
