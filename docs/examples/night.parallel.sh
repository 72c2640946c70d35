#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A night by GNU parallel: on this machine, or on those that the options behind SHARDS name.
#   night.parallel.sh STORE RESULTS SHARDS [options of parallel, such as --jobs 2 --sshlogin node1,node2]
# RESULTS is a folder that all machines see, without a plan in it; the store lies on this machine's own disk.
set -euo pipefail
store=$1 results=$2 shards=$3
stratalux-fit batch plan --store "$store" --out "$results" ${STRATALUX_FIT_OPTIONS:-}
# A shard that was stopped or killed goes on, twice; visitors who could not be fitted (exit code 3) are told by the merge.
parallel --retries 3 "${@:4}" \
  "stratalux-fit batch shard {}/$shards --store $store --results $results --workers 1 || [ \$? -eq 3 ]" ::: $(seq "$shards") || true
stratalux-fit batch merge "$results" --store "$store"
