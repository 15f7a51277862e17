#!/bin/bash
# The small pipeline under Snakemake's local executor: exported, killed half-way, resumed, and compared with a plain run.
# Two arguments: the program, and the Snakemake to use.
set -euo pipefail
program=$(realpath "$1")
snakemake=$(realpath -s "$2")
pipeline=$(realpath "$(dirname "$0")/../../pipelines/i3ds.ron")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
small=(--set 'scene.source=Procedural(views: 6, size: (64, 48))' --set scene.holdout=3 --set fit.steps=300
    --set i3ds.count=2 --set i3ds.optimize.steps=4 --set i3ds.optimize.guidance.warm_up=1 --set i3ds.sync.steps=20
    --set i3ds.render.shards=2 --set i3ds.optimize.shards=2)
export XDG_CACHE_HOME=$folder/cache HOME=$folder

"$program" run "$pipeline" "${small[@]}" --quiet --store plain/store --out plain/out >/dev/null
"$program" export snakemake "$pipeline" "${small[@]}"

# A process group of its own, so that everything dies at once, as when a machine loses its power.
setsid "$snakemake" --cores 2 --rerun-incomplete --nolock >first.log 2>&1 &
victim=$!
for _ in $(seq 300); do [ -e stamps/i3ds/i3ds.1.render.json ] && break; sleep 0.2; done
kill -KILL -- -$victim
wait $victim || true
[ ! -e stamps/i3ds/evaluate.json ] || { echo 'it was over before it was killed' >&2; exit 1; }

"$snakemake" --cores 2 --rerun-incomplete --nolock >second.log 2>&1 || { tail -n 30 second.log >&2; exit 1; }
diff -r --exclude=.srnerf-stages.json plain/out out
"$snakemake" --cores 2 --nolock >third.log 2>&1
! grep -q 'rule scene' third.log || { echo 'what is done was done again' >&2; exit 1; }
# One parameter further, Snakemake's own trigger agrees with ours: what depends on it runs, and says why.
"$program" export snakemake "$pipeline" "${small[@]}" --set i3ds.sync.steps=21 >/dev/null
"$snakemake" --cores 2 --nolock --dry-run >fourth.log 2>&1
grep -q 'Params have changed' fourth.log || { tail -n 30 fourth.log >&2; exit 1; }
! grep -q 'rule fit' fourth.log || { echo 'a fit that nothing changed would run' >&2; exit 1; }
echo "Snakemake and the plain run agree"
