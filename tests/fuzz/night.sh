#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The night part `fuzz`: builds the preset `fuzz` and gives every target STRATALUX_FUZZ_SECONDS (60), from its kept
# inputs on. What breaks a reader is kept and named. Without clang: exit code 77, skipped.
#   tests/fuzz/night.sh [TARGET ...]
set -euo pipefail
root=$(cd "$(dirname "$0")/../.." && pwd)
seconds=${STRATALUX_FUZZ_SECONDS:-60}
command -v clang++ >/dev/null || { echo "skipped: no clang++ (scripts/install-deps.sh installs it)"; exit 77; }
cd "$root"
cmake --preset fuzz >/dev/null
cmake --build --preset fuzz
work=build/fuzz/inputs
faults=0
targets=("$@")
[ ${#targets[@]} -gt 0 ] || for file in tests/fuzz/*_fuzz.cc; do
  name=$(basename "$file" _fuzz.cc)
  targets+=("$name")
done
mkdir -p "$work/faults"
fuzz_one() {
  local target=$1 log=$work/$1.log
  mkdir -p "$work/$target"
  # New inputs go to the first folder; a minute for one of them is a hang.
  if build/fuzz/fuzz/"${target}_fuzz" -max_total_time="$seconds" -seed="${STRATALUX_SEED:-1}" -timeout=60 -rss_limit_mb=3072 \
      -max_len=16384 -print_final_stats=1 -artifact_prefix="$work/faults/$target-" \
      "$work/$target" "tests/fuzz/corpus/$target" >"$log" 2>&1; then
    echo "$target: $(sed -n 's/^stat::number_of_executed_units: *//p' "$log") inputs in $seconds s, no fault"
  else
    echo "$target: FAULT; its input is in $work/faults, what was said in $log:"
    tail -n 30 "$log"
    return 1
  fi
}
# As many at a time as there are cores.
running=0
for target in "${targets[@]}"; do
  if [ $running -ge "$(nproc)" ]; then wait -n || faults=$((faults + 1)); running=$((running - 1)); fi
  fuzz_one "$target" &
  running=$((running + 1))
done
while [ $running -gt 0 ]; do wait -n || faults=$((faults + 1)); running=$((running - 1)); done
echo "fuzz: ${#targets[@]} targets, $faults with a fault"
[ $faults -eq 0 ]
