#!/bin/bash
# A remote on a local S3 server, moto: what one machine computed another fetches, in pieces where blobs are large; the first put of a
# result wins. Two arguments: the program, and moto's server.
set -euo pipefail
program=$(realpath "$1")
moto=$(realpath -s "$2")
root=$(realpath "$(dirname "$0")/../..")
folder=$(mktemp -d)
cd "$folder"
port=$((20000 + RANDOM % 20000))
"$moto" -H 127.0.0.1 -p $port >moto.log 2>&1 &
server=$!
trap 'kill $server; rm -rf "$folder"' EXIT
export AWS_ENDPOINT=http://127.0.0.1:$port AWS_ALLOW_HTTP=true AWS_REGION=us-east-1
export AWS_ACCESS_KEY_ID=testing AWS_SECRET_ACCESS_KEY=testing
for _ in $(seq 100); do curl -sf "$AWS_ENDPOINT/moto-api/" >/dev/null && break; sleep 0.1; done
curl -sf -X PUT "$AWS_ENDPOINT/bucket" >/dev/null

remote=s3://bucket/team
run() { "$program" run "$root/pipelines/smoke.ron" --set fit.steps=20 --target fit --json --store "$1/store" --out "$1/out" --remote $remote; }
run a | tail -n 1 | grep -q '"ran":\["fit","scene"\]'
find a/store/cas -type f -size +8M | grep -q . || { echo 'no blob is large enough to travel in pieces' >&2; exit 1; }
run b | tail -n 1 | grep -q '"ran":\[\]'
diff -r a/out b/out
run c >/dev/null
"$program" store push $remote --store c/store | grep -qx 'pushed 0 results, 0 B'
"$program" store pull $remote --store d/store | grep -q '^pulled 2 results'
"$program" run "$root/pipelines/smoke.ron" --set fit.steps=20 --target fit --json --store d/store --out d/out | tail -n 1 | grep -q '"ran":\[\]'

kill $server
wait $server || true
# With the server gone, the run goes on, and says so once.
"$program" run "$root/pipelines/smoke.ron" --set fit.steps=21 --target fit --store e/store --out e/out --remote $remote 2>gone.log
[ "$(grep -c 'going on without it' gone.log)" = 1 ] || { cat gone.log >&2; exit 1; }
trap 'rm -rf "$folder"' EXIT
echo "the S3 server's store works"
