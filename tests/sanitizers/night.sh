#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The night part `sanitizers`: every unit test, and a tiny session captured, fitted and verified, under the address and
# undefined-behaviour sanitizers (preset asan).
#   tests/sanitizers/night.sh [REGEX]    only the unit tests of that name
set -euo pipefail
root=$(cd "$(dirname "$0")/../.." && pwd)
cd "$root"
jobs=${STRATALUX_JOBS:-$(nproc)}
cmake --preset asan >/dev/null
cmake --build --preset asan -j "$jobs" --target programs unit_tests
failed=0
ctest --test-dir build/asan -L '^unit$' -j "$jobs" --output-on-failure ${1:+-R "$1"} || failed=1

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export PATH=$root/build/asan/bin:$PATH STRATALUX_STORE=$work/store STRATALUX_CACHE='' STATE_DIRECTORY=/nonexistent
{ printf '[camera]\nwidth = 96\nheight = 72\n'; cat "$root/tests/support/smallest_plan.toml"; } >"$work/rig.toml"
step() { echo "$ $*"; "$@" >"$work/said" 2>&1 || { echo "exit code $?"; tail -n 40 "$work/said"; failed=1; }; }
step stratalux-rig capture --simulate --config "$work/rig.toml" --seed 5
step stratalux-fit run latest
step stratalux-fit render latest --point=-200,-150,250 --out "$work/relit"
step stratalux-fit export latest --out "$work/face"
step stratalux-db export latest --out "$work/pictures" --format tiff
step stratalux-db verify --deep
step stratalux-db reindex
[ $failed -eq 0 ] && echo "sanitizers: nothing found" || echo "sanitizers: FAULT"
exit $failed
