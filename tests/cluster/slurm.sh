#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# `stratalux-fit batch submit --engine slurm` on a real Slurm of this test's own (slurm-lib.sh): how often 15,000 visitors
# call it, and that whatever is killed in the middle of an array, every visitor is fitted once.   slurm.sh SOURCE BUILD
set -euo pipefail
source=$1 build=$2
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/slurm-lib.sh"
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/night-lib.sh"
! slurm_missing || exit 77
scratch=$(mktemp -d)
answering=
trap '[ -z "$answering" ] || kill "$answering" 2>/dev/null; slurm_stop; rm -rf "$scratch"' EXIT
# More than there are: a stand-in only waits for its turn.
export PATH=$build/bin:$PATH TMPDIR=$scratch SLURM_TEST_CPUS=8
slurm_start "$build/tests/cluster/slurm"
cd "$scratch"

# 15,000 visitors of 70 processor seconds, in tasks of two hours on two cores. The stand-in notes its shard; shard 5 never
# ends, shard 7 is stopped once.
count_calls() {
  local tool program tasks calls
  mkdir wrapped
  for tool in sbatch scontrol squeue sinfo scancel sacct; do
    program=$(command -v $tool) || continue
    printf '#!/bin/sh\necho "%s $*" >>"%s/calls"\nexec "%s" "$@"\n' $tool "$scratch" "$program" >wrapped/$tool
  done
  cat >standin <<STANDIN
#!/bin/sh
echo "\$3" >>"$scratch/shards"
case \$3 in
  5/*) exit 75 ;;
  7/*) [ "\$SLURM_RESTART_COUNT" ] || exit 75 ;;
esac
STANDIN
  chmod +x standin wrapped/*
  : >calls
  "$build/bin/plan_of_many" many 15000 70
  stratalux-db init --store none >/dev/null
  PATH=$scratch/wrapped:$PATH stratalux-fit batch submit --engine slurm --store none --results many --chunk-minutes 120 \
    --cpus 2 --task "$scratch/standin" >said 2>&1 || { cat said; fail "submit"; }
  slurm_drain 600
  tasks=$((15000 * 70 / 2 / 60 / 120 + 1))
  [ "$(sort -u shards | wc -l)" -eq $tasks ] || fail "$(sort -u shards | wc -l) shards of $tasks ran"
  [ "$(grep -c '^5/' shards)" -eq 4 ] || { squeue -r -t all | grep _4; cat many/slurm/*_4.log; } >&2
  [ "$(grep -c '^5/' shards)" -eq 4 ] || fail "shard 5 ran $(grep -c '^5/' shards) times: once and three times again"
  [ "$(grep -c '^7/' shards)" -eq 2 ] || fail "shard 7 ran $(grep -c '^7/' shards) times"
  [ "$(wc -l <shards)" -eq $((tasks + 4)) ] || fail "another shard ran twice"
  calls=$(wc -l <calls)
  [ "$calls" -le 100 ] || { cat calls; fail "$calls calls of Slurm"; }
  # What the slurmctld itself counted.
  sdiag >counted
  rpc() { sed -n "s/^\t$1 .*count:\([0-9]*\).*/\1/p" counted; }
  [ "$(rpc REQUEST_SUBMIT_BATCH_JOB)" -eq "$(grep -c '^sbatch' calls)" ] || { cat counted; fail "submissions"; }
  [ "$(rpc REQUEST_JOB_REQUEUE)" -eq 4 ] || { cat counted; fail "requeues"; }
  echo "15000 visitors, $tasks tasks: $calls calls ($(cut -d' ' -f1 calls | sort | uniq -c | tr -s ' \n' ' ')), submissions by sdiag: $(rpc REQUEST_SUBMIT_BATCH_JOB)"
}

# Ids of processes whose command line holds both words.
processes() {
  { grep -lzs -- "$1" /proc/[0-9]*/cmdline || true; } | { xargs -r grep -lzs -- "$2" || true; } | cut -d/ -f3
}
# SIGKILL to the first of them, as soon as there is one.
kill_one() {
  local i pid
  for ((i = 0; i < 600; ++i)); do
    pid=$(processes "$1" "$2" | head -n 1) || true
    if [ -n "$pid" ] && kill -KILL "$pid" 2>/dev/null; then return 0; fi
    sleep 0.1
  done
  tail -n 5 results/slurm/*.log "$slurm_folder/slurmctld.log" >&2 || true
  squeue >&2 || true
  fail "nothing to kill: $1 $2"
}

kill_everything_once() {
  local i
  small_store store 1
  # shellcheck disable=SC2086
  stratalux-fit run latest --store store $small_options >/dev/null 2>&1 || fail "a fit"
  small_store store "${STRATALUX_CLUSTER_VISITORS:-5}"
  # shellcheck disable=SC2086
  stratalux-fit batch submit --engine slurm --store store --results results --chunk-minutes 0.001 --cpus 1 $small_options \
    >said 2>&1 || { cat said; fail "submit"; }
  kill_one "$scratch/results" shard     # a task's program: its script has it queued again
  slurm_kill slurmctld
  slurm_run slurmctld
  kill_one "$slurm_folder/spool" slurm_script # the script itself
  slurm_kill slurmd
  slurm_run slurmd
  slurm_wait_answer
  slurm_drain 600
  # Whose script was killed waits for another night, or --again.
  stratalux-fit batch merge results --store store >merged 2>&1 || true
  for ((i = 0; i < 3; ++i)); do
    stratalux-fit batch submit --engine slurm --store store --results results --cpus 1 --again >said 2>&1 || { cat said; fail "submit --again"; }
    slurm_drain 600
    stratalux-fit batch merge results --store store >merged 2>&1 && break
  done
  stratalux-fit batch merge results --store store >merged 2>&1 || { cat merged results/slurm/*.log; fail "not all were merged"; }
  grep -q " 0 failed, 0 missing" merged || { cat merged; fail "merge"; }
  all_fitted_once store
  stratalux-fit batch merge results --store store --close >/dev/null 2>&1 || fail "merge --close"
  [ ! -e results ] || fail "results are left"
  echo "$(find store/sessions -mindepth 1 -maxdepth 1 | wc -l) visitors, each fitted once"
}

# Tasks see the sessions and no key; who answers stands where the store is.
keys_by_asking() {
  local part
  small_store locked 1
  # shellcheck disable=SC2086
  stratalux-fit run latest --store locked $small_options >/dev/null 2>&1 || fail "a fit"
  stratalux-db key reader-init --out reader.key >reader.pub
  stratalux-db key share reader.pub --store locked >said 2>&1 || true # one visitor is not encrypted
  small_store locked 1 --encrypt
  mkdir seen
  for part in sessions ledger; do ln -s "$scratch/locked/$part" seen/$part; done
  # shellcheck disable=SC2086
  stratalux-fit batch submit --engine slurm --store locked --task-store seen --results asked --ask-keys --cpus 1 $small_options \
    >said 2>&1 || { cat said; fail "submit --ask-keys"; }
  stratalux-fit batch keys --answer --store locked --results asked --every 0.2 >answered 2>&1 &
  answering=$!
  slurm_drain 600
  kill -TERM $answering
  wait $answering || { cat answered; fail "batch keys --answer"; }
  answering=
  stratalux-fit batch merge asked --store locked >merged 2>&1 || { cat merged asked/slurm/*.log; fail "merge"; }
  grep -q "1 fits entered" merged || { cat merged; fail "merge"; }
  all_fitted_once locked
  [ -z "$(find asked/keys -mindepth 1)" ] || fail "asks or answers are left"
  echo "an encrypted visitor fitted: $(tail -n 1 answered)"
}

count_calls
kill_everything_once
keys_by_asking
