#!/usr/bin/env bash
# Installs the package on a Debian that has nothing else, in a folder of its own; runs a job there without a network, as a user who
# may write to no other place; and takes the package away without a trace.
#
#     tests/dist/deb.sh PACKAGE.deb [PIPELINE]     (needs root, debootstrap and a Debian mirror; PIPELINE is smoke by default)
set -euo pipefail
package=$(realpath "$1")
pipeline=${2:-smoke}
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
# The user who runs the job sees it as its /.
chmod 755 "$root"

# shellcheck disable=SC1091
debootstrap --variant=minbase "$(. /etc/os-release && echo "$VERSION_CODENAME")" "$root" >/dev/null
inside() { unshare --net chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/nowhere "$@"; }
# What dpkg and ldconfig note down is no trace of a package.
files() { find "$root" -xdev \( -path '*/var/lib/dpkg' -o -path '*/var/log' -o -path '*/var/cache' -o -path '*/tmp' \) -prune -o -print | sort; }

before=$(files)
cp "$package" "$root/tmp/srnerf-dag.deb"
inside dpkg --install /tmp/srnerf-dag.deb >/dev/null
inside srnerf-dag --version
inside install -d -o 1000 -g 1000 /tmp/job
inside sh -c "cd /tmp/job && exec setpriv --reuid 1000 --regid 1000 --clear-groups \
    srnerf-dag run /usr/share/srnerf-dag/pipelines/$pipeline.ron --no-progress" | tail -4
ls "$root"/tmp/job/out/"$pipeline" >/dev/null
inside dpkg --purge srnerf-dag >/dev/null
diff <(echo "$before") <(files) || { echo 'the package leaves files behind' >&2; exit 1; }
echo "$(basename "$package"): installed, ran $pipeline, and gone"
