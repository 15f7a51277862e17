#!/bin/bash
# Runs a command on a Slurm cluster of one node, this machine, on loopback; stops the cluster in the end.
#
#   tests/slurm/one_node.sh COMMAND..      as root, on Debian or Ubuntu, where no Slurm runs yet
#
# Installs Debian's packages where they are missing. There is no accounting, and the node takes jobs as any other would.
set -euo pipefail

[ $# -gt 0 ] || { echo "usage: $0 COMMAND.." >&2; exit 2; }
[ "$(id -u)" = 0 ] || { echo "only root can start Slurm's daemons" >&2; exit 2; }
if pgrep -x slurmctld >/dev/null || pgrep -x slurmd >/dev/null; then echo "a Slurm runs here already; it is left alone" >&2; exit 2; fi
if ! command -v slurmctld slurmd munged >/dev/null; then
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq slurm-wlm munge; } >&2
    # The packages start a munge of their own; ours has another key.
    service munge stop >&2 || true
fi

conf=/etc/slurm/slurm.conf
work=$(mktemp -d /tmp/one-node-XXXXXX)
backup=
[ ! -e "$conf" ] || { backup=$work/slurm.conf.before; cp "$conf" "$backup"; }

stop() {
    for daemon in slurmd slurmctld munged; do
        [ ! -s "$work/$daemon.pid" ] || kill "$(cat "$work/$daemon.pid")" 2>/dev/null || true
    done
    sleep 1
    if [ -n "$backup" ]; then cp "$backup" "$conf"; else rm -f "$conf"; fi
    rm -rf "$work"
}
trap stop EXIT

# Munge vouches for users; a key of its own, and a socket of its own, leave another munge alone.
dd if=/dev/urandom of="$work/munge.key" bs=1024 count=1 status=none
chown munge "$work" "$work/munge.key"
chmod 400 "$work/munge.key"
chmod 711 "$work"
runuser -u munge -- munged --key-file="$work/munge.key" --socket="$work/munge.sock" --pid-file="$work/munged.pid" \
    --log-file="$work/munged.log" --seed-file="$work/munged.seed" --force

mkdir -p "$work/state" "$work/spool" /etc/slurm
memory=$(($(awk '/MemTotal/ { print $2 }' /proc/meminfo) / 1024))
cat > "$conf" <<CONF
ClusterName=one
SlurmctldHost=$(hostname -s)(127.0.0.1)
AuthType=auth/munge
AuthInfo=socket=$work/munge.sock
CredType=cred/munge
SlurmUser=root
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
MinJobAge=600
JobRequeue=1
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
SlurmctldParameters=enable_configless
ReturnToService=2
MailProg=/bin/true
SchedulerParameters=sched_interval=2,batch_sched_delay=1,requeue_setup_env_fail
NodeName=$(hostname -s) NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=$memory State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF

slurmctld
slurmd
for _ in $(seq 60); do
    [ "$(sinfo -h -o %T 2>/dev/null)" = idle ] && break
    sleep 0.5
done
if [ "$(sinfo -h -o %T)" != idle ]; then
    tail -n 20 "$work"/*.log >&2
    exit 1
fi
"$@"
