#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A night by GNU parallel: on this machine, or on those that the options behind SHARDS name.
#   night.parallel.sh STORE RESULTS SHARDS [options of parallel, such as --jobs 2 --sshlogin node1,node2]
# RESULTS is a folder that all machines see, without a plan in it; the store lies on this machine's own disk.
set -euo pipefail
store=$1 results=$2 shards=$3
stratalux-fit batch plan --store "$store" --out "$results" ${STRATALUX_FIT_OPTIONS:-}
# A shard that was stopped or killed goes on, twice; visitors who could not be fitted (exit code 3) are told by the merge.
printf -v at ' --store %q --results %q' "$store" "$results"  # a shell reads the command once more
parallel --retries 3 "${@:4}" \
  "stratalux-fit batch shard {}/$shards$at --workers 1 || [ \$? -eq 3 ]" ::: $(seq "$shards") ||
  echo "night: $? of $shards shards did not end; the merge says what is missing" >&2
stratalux-fit batch merge "$results" --store "$store"
