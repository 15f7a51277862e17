#!/usr/bin/env bash
# Checks the kernels on this machine's GPU, measures them, and runs the main job there: ten minutes at most, builds aside.
#
#     [GPU=1] [PEAK=GFLOPS,GBS] benches/gpu.sh FOLDER [PYTHON]
#
# FOLDER gets a file of each part, and gpu.md with all that docs/gpu.md needs. GPU is the number that `srnerf-dag doctor` gives an
# adapter, by default the first that is hardware; PEAK as for `make bench-gpu`. With PYTHON, one that has torch with CUDA, PyTorch's
# operators are timed beside ours. A part that fails is named at the end.
set -u
mkdir -p "$1"
folder=$(cd "$1" && pwd)
python=${2:-}
cd "$(dirname "$0")/.."
program=${CARGO_TARGET_DIR:-target}/release/srnerf-dag
device=gpu${GPU:+:$GPU}
failed=

# part NAME SECONDS COMMAND...: what it prints goes to FOLDER/NAME and to gpu.md.
part() {
    local name=$1 limit=$2
    shift 2
    local begin=$SECONDS
    timeout "$limit" "$@" >"$folder/$name" 2>&1 || failed="$failed $name"
    { echo "## $name"; echo; cat "$folder/$name"; echo; } >>"$folder/gpu.md"
    echo "$name: $((SECONDS - begin)) s"
}

cargo build --release --quiet && cargo test --release --workspace --no-run --quiet && cargo bench --workspace --no-run --quiet || exit
: >"$folder/gpu.md"
part doctor 30 "$program" doctor
part operators 60 env GPU="${GPU:-}" PEAK="${PEAK:-}" cargo bench --quiet --workspace --bench gpu
[ -z "$python" ] || part pytorch 60 "$python" stages/compute/benches/gpu.py
export SRNERF_REQUIRE_GPU=1
part tests-of-operators 120 cargo test --release --quiet --workspace --test gpu
part tests-of-networks 120 cargo test --release --quiet --workspace --lib --test networks --test spheres gpu
part main-job 180 "$program" run pipelines/i3ds.ron --device "$device" --store "$folder/store" --out "$folder/out" --no-progress
[ -z "$failed" ] || { echo "failed or not done in their time:$failed" >&2; exit 1; }
