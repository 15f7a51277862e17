#!/bin/bash
# The small pipeline on a Slurm cluster: exported, submitted, warned in the middle of a training so that it must queue itself again,
# and compared with a plain run. One argument: the program.
#
#   tests/slurm/one_node.sh tests/slurm/export.sh target/release/srnerf-dag
set -euo pipefail
program=$(realpath "$1")
pipeline=$(realpath "$(dirname "$0")/../../pipelines/smoke.ron")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
small=(--set 'scene.source=Procedural(views: 6, size: (64, 48))' --set scene.holdout=3 --set fit.steps=1500
    --set i3ds.count=1 --set i3ds.optimize.steps=4 --set i3ds.optimize.guidance.warm_up=1 --set i3ds.sync.steps=10
    --set i3ds.render.shards=2 --set i3ds.optimize.shards=2)

"$program" run "$pipeline" "${small[@]}" --quiet --store plain/store --out plain/out >/dev/null
"$program" export slurm "$pipeline" "${small[@]}"
sh slurm/submit.sh
for _ in $(seq 120); do squeue -h -n fit -t running -o %i | grep -q . && break; sleep 0.5; done
sleep 2
scancel --batch --signal=USR1 --name=fit
for _ in $(seq 400); do squeue -h | grep -q . || break; sleep 1; done
if squeue -h | grep -q .; then squeue >&2; exit 1; fi

grep -h 'sr_nerf' slurm/logs/smoke-*.log
grep -l 'interrupted' slurm/logs/fit-*.log >/dev/null || { echo 'the training was not interrupted' >&2; exit 1; }
[ "$(grep -c 'running (' slurm/logs/fit-*.log)" = 2 ] || { echo 'the training did not go on' >&2; exit 1; }
# Provenance apart, which has no times or hosts in it either, the bytes are those of the plain run.
diff -r --exclude=.srnerf-stages.json plain/out out
echo "the cluster and the plain run agree"
