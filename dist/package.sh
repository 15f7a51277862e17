#!/usr/bin/env bash
# Packs a release: a .deb and an archive with the program, its pipelines, manual pages and completions; a list of all crates in it
# (SPDX); and checksums of these. Packing the same program of the same commit twice gives the same bytes,
# and what is stripped from the program, such as the folder that it was built in, goes into none of them.
#
#     dist/package.sh PROGRAM FOLDER
#
# Needs dpkg-deb, strip, objdump, xz and cargo. The program links to the system's C library alone; a Vulkan loader, COLMAP and ffmpeg
# are looked for when they are asked for.
set -euo pipefail
program=$(realpath "$1")
mkdir -p "$2"
out=$(realpath "$2")
cd "$(dirname "$0")/.."

version=$("$program" --version | cut -d' ' -f2)
arch=$(dpkg --print-architecture)
name=srnerf-dag-$version-linux-$arch
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
export SOURCE_DATE_EPOCH
staging=$(mktemp -d)
trap 'rm -rf "$staging"' EXIT

# The files, as they lie in the archive and, under usr/, in the package.
share=$staging/files/usr/share
mkdir -p "$staging/files/usr/bin" "$share/srnerf-dag" "$share/doc/srnerf-dag"
# The linker's build ID is a digest of what is stripped, too, and so of the folder that the program was built in.
strip --remove-section=.note.gnu.build-id -o "$staging/files/usr/bin/srnerf-dag" "$program"
cp -r pipelines "$share/srnerf-dag/"
cp LICENSE-MIT LICENSE-APACHE README.md "$share/doc/srnerf-dag/"
gzip -n9 <CHANGELOG.md >"$share/doc/srnerf-dag/changelog.gz"
"$program" man --output "$share/man/man1" >/dev/null
gzip -n9 "$share"/man/man1/*.1
completions() { mkdir -p "$(dirname "$share/$2")" && "$program" completions "$1" >"$share/$2"; }
completions bash bash-completion/completions/srnerf-dag
completions zsh zsh/vendor-completions/_srnerf-dag
completions fish fish/vendor_completions.d/srnerf-dag.fish
cat >"$share/doc/srnerf-dag/copyright" <<END
Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
Files: *
Copyright: the srnerf-dag developers
License: MIT or Apache-2.0
Comment: The texts lie beside this file; on Debian, Apache-2.0 is in /usr/share/common-licenses, too. The embedded networks' weights are CC0.
 The licences of the crates in the program are in the release's .spdx file.
END
chmod -R u=rwX,go=rX "$staging/files"

# The oldest C library that has all symbols that the program asks for.
libc=$(objdump -T "$program" | grep -o 'GLIBC_[0-9.]*' | sort -Vu | tail -1 | cut -d_ -f2)
mkdir "$staging/files/DEBIAN"
cat >"$staging/files/DEBIAN/control" <<END
Package: srnerf-dag
Version: $version
Architecture: $arch
Maintainer: the srnerf-dag developers <srnerf-dag@localhost>
Section: graphics
Priority: optional
Installed-Size: $(du -sk --exclude DEBIAN "$staging/files" | cut -f1)
Depends: libc6 (>= $libc), libgcc-s1
Suggests: libvulkan1, colmap, ffmpeg
Description: super-resolves radiance fields
 Takes posed low-resolution photos and makes a NeRF that renders at four times their resolution, sharp and consistent between views, by
 iterative 3D synchronization (WACV 2025). Every step is a cached stage that reads and writes EXR and safetensors.
END
dpkg-deb --root-owner-group -Zxz --build "$staging/files" "$out/srnerf-dag_${version}_$arch.deb" >/dev/null
rm -r "$staging/files/DEBIAN"

mv "$staging/files/usr" "$staging/$name"
tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" -C "$staging" -cJf "$out/$name.tar.xz" "$name"

# One paragraph for each crate: name, version, licence.
{
    printf 'SPDXVersion: SPDX-2.3\nDataLicense: CC0-1.0\nSPDXID: SPDXRef-DOCUMENT\nDocumentName: %s\n' "$name"
    printf 'DocumentNamespace: https://spdx.org/spdxdocs/%s-%s\n' "$name" "$(sha256sum <"$staging/$name/bin/srnerf-dag" | cut -c1-32)"
    printf 'Creator: Tool: package.sh\nCreated: %s\n' "$(date -u -d "@$SOURCE_DATE_EPOCH" +%Y-%m-%dT%H:%M:%SZ)"
    cargo tree --locked --edges normal --prefix none --format '{p}|{l}' | sed 's/ ([^|]*)|/|/; s/ (\*)$//' | sort -u |
        awk -F'|' '{
            split($1, crate, " v"); licence = $2; gsub("/", " OR ", licence); id = crate[1] "-" crate[2]; gsub("[^A-Za-z0-9.-]", "-", id)
            printf "\nPackageName: %s\nSPDXID: SPDXRef-%s\nPackageVersion: %s\n", crate[1], id, crate[2]
            printf "PackageDownloadLocation: NOASSERTION\nFilesAnalyzed: false\nPackageLicenseConcluded: NOASSERTION\n"
            printf "PackageLicenseDeclared: %s\nPackageCopyrightText: NOASSERTION\n", licence == "" ? "NOASSERTION" : licence
            printf "Relationship: SPDXRef-DOCUMENT DESCRIBES SPDXRef-%s\n", id
        }'
} >"$out/$name.spdx"

cd "$out"
sha256sum "srnerf-dag_${version}_$arch.deb" "$name.tar.xz" "$name.spdx" >SHA256SUMS
cat SHA256SUMS
