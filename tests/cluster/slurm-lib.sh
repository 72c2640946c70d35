# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# A Slurm of a test's own: munged, slurmctld and one slurmd on loopback, without systemd, everything below one folder, in
# ports that were free. For root and for other accounts. Sourced by tests that run under `set -euo pipefail`.
#
#   slurm_missing            names what is not installed; true where something is
#   slurm_start FOLDER       sets SLURM_CONF; returns when a job could run
#   slurm_kill NAME          SIGKILL to slurmctld or slurmd; slurm_run NAME starts it again
#   slurm_stop               ends all of it, jobs included

slurm_missing() {
  local missing="" program
  for program in slurmctld slurmd munged sbatch scontrol squeue setpriv; do
    PATH=$PATH:/usr/sbin:/sbin command -v "$program" >/dev/null || missing+=" $program"
  done
  [ -n "$missing" ] || return 1
  echo "skipped: not installed:$missing (scripts/install-deps.sh --groups cluster)" >&2
}

# Ports of loopback that nobody listens on.
free_ports() { python3 -c '
import socket, sys
held = [socket.socket() for _ in range(int(sys.argv[1]))]
for each in held: each.bind(("127.0.0.1", 0))
print(*[each.getsockname()[1] for each in held])' "$1"; }

slurm_config() {
  local ports host
  host=$(hostname -s)
  read -r -a ports < <(free_ports 2)
  cat >"$slurm_folder/slurm.conf" <<CONF
ClusterName=night
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=${ports[0]}
SlurmdPort=${ports[1]}
AuthType=auth/munge
AuthInfo=socket=$slurm_folder/munge/socket
CredType=cred/munge
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
StateSaveLocation=$slurm_folder/state
SlurmdSpoolDir=$slurm_folder/spool
SlurmctldPidFile=$slurm_folder/slurmctld.pid
SlurmdPidFile=$slurm_folder/slurmd.pid
SlurmctldLogFile=$slurm_folder/slurmctld.log
SlurmdLogFile=$slurm_folder/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
MpiDefault=none
SwitchType=switch/none
MailProg=/bin/true
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,default_queue_depth=1000
SlurmdParameters=config_overrides
ReturnToService=2
SlurmdTimeout=20
KillWait=5
MaxArraySize=20001
MaxJobCount=40000
MinJobAge=600
NodeName=$host NodeAddr=127.0.0.1 CPUs=${SLURM_TEST_CPUS:-2} RealMemory=4096 State=UNKNOWN
PartitionName=night Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
}

# As an account that is not root, which munged refuses.
munge_run() {
  local as=()
  mkdir -p "$slurm_folder/munge"
  head -c 1024 /dev/urandom >"$slurm_folder/munge/key"
  chmod 700 "$slurm_folder/munge"
  chmod 600 "$slurm_folder/munge/key"
  if [ "$(id -u)" -eq 0 ]; then
    chown -R nobody "$slurm_folder/munge"
    as=(setpriv "--reuid=$(id -u nobody)" "--regid=$(id -g nobody)" --clear-groups)
  fi
  chmod 755 "$slurm_folder/munge"
  # The folders above are the builder's, whose rights munged would doubt: --force.
  PATH=$PATH:/usr/sbin "${as[@]}" munged --foreground --force --num-threads=2 --key-file="$slurm_folder/munge/key" \
    --socket="$slurm_folder/munge/socket" --pid-file="$slurm_folder/munge/pid" --log-file="$slurm_folder/munge/log" \
    --seed-file="$slurm_folder/munge/seed" >"$slurm_folder/munged.said" 2>&1 &
  slurm_pids[munged]=$!
}

slurm_run() {
  PATH=$PATH:/usr/sbin setsid "$1" -D -f "$slurm_folder/slurm.conf" >>"$slurm_folder/$1.said" 2>&1 &
  slurm_pids[$1]=$!
}

slurm_kill() {
  kill -KILL "${slurm_pids[$1]}" 2>/dev/null || true
  wait "${slurm_pids[$1]}" 2>/dev/null || true
}

slurm_wait_up() {
  local i
  for ((i = 0; i < 300; ++i)); do
    [ "$(sinfo -h -o %T 2>/dev/null)" != idle ] || return 0
    sleep 0.2
  done
  tail -n 20 "$slurm_folder"/slurm*.log "$slurm_folder"/*.said "$slurm_folder/munge/log" >&2 || true
  echo "no Slurm after a minute" >&2
  return 1
}

# A job that was queued again would wait for two minutes. At once is too early: slurmd takes a credential of the second in
# which it ended the job before as that job's, "already killed", and the task fails without having run. Takes a second. And a task
# that slurmd of a busy machine could not launch is held, for an administrator to release.
slurm_hurry() {
  local job waiting
  for job in $(squeue -h -r -t PENDING -o '%i %r' 2>/dev/null | sed -n 's/ launch failed requeued held$//p'); do
    scontrol release "$job" 2>/dev/null || true
  done
  waiting=$(squeue -h -r -t PENDING -o '%i %r' 2>/dev/null | sed -n 's/ BeginTime$//p') || true
  sleep 1.1
  for job in $waiting; do scontrol update "JobId=$job" StartTime=now 2>/dev/null || true; done
}

# Until every job there was has ended. By itself squeue shows what waits, runs and completes: not a task that is being queued
# again (REQUEUED), of which a look at the wrong moment sees nothing.
slurm_drain() {
  local i left
  for ((i = 0; i < ${1:-300}; ++i)); do
    left=$(squeue -h -r -t all -o %T 2>/dev/null | { grep -vcxE 'COMPLETED|FAILED|CANCELLED|TIMEOUT|NODE_FAIL' || true; }) || left=1
    [ "$left" -gt 0 ] || return 0
    slurm_hurry
  done
  squeue -r >&2 || true
  echo "the queue is not empty after ${1:-300} looks" >&2
  return 1
}

# slurmctld answers, whatever its nodes do.
slurm_wait_answer() {
  local i
  for ((i = 0; i < 300; ++i)); do
    ! squeue -h >/dev/null 2>&1 || return 0
    sleep 0.2
  done
  return 1
}

slurm_start() {
  declare -gA slurm_pids
  slurm_folder=$1
  rm -rf "$slurm_folder"
  mkdir -p "$slurm_folder/state" "$slurm_folder/spool"
  export SLURM_CONF=$slurm_folder/slurm.conf
  slurm_config
  munge_run
  until [ -S "$slurm_folder/munge/socket" ]; do
    kill -0 "${slurm_pids[munged]}" 2>/dev/null || { cat "$slurm_folder/munged.said" >&2; return 1; }
    sleep 0.05
  done
  slurm_run slurmctld
  slurm_run slurmd
  slurm_wait_up
}

# What runs in SPOOL or speaks to this slurmctld: its daemons, the steps' keepers and their jobs, each by its own id.
slurm_stop() {
  local name pid
  timeout 10 scancel --state=RUNNING --signal=KILL --full --user="$(id -un)" >/dev/null 2>&1 || true
  for name in slurmd slurmctld munged; do
    [ -z "${slurm_pids[$name]:-}" ] || slurm_kill "$name"
  done
  # Keepers of jobs (slurmstepd) outlive their slurmd; they and their jobs carry our configuration in their environment.
  grep -lsz "^SLURM_CONF=$SLURM_CONF\$" /proc/[0-9]*/environ 2>/dev/null | cut -d/ -f3 | while read -r pid; do
    # This shell has it, too, but it did not begin with it.
    kill -KILL "$pid" 2>/dev/null || true
  done || true
}
