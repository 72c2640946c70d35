#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Cross-compiles this tree for 64-bit Arm in a root of Debian, packages it, and runs its tests and a simulated capture under
# qemu-user. ctest's closing line and one of the capture end the output.
set -euo pipefail
usage() {
  cat <<'HELP'
usage: scripts/test-arm64.sh [12|13] [--fresh] [--cache DIR] [--debs DIR] [-j N] [ctest argument ...]
  12, 13             the release of Debian (default 12)
  --fresh            make a new root; otherwise the packages and objects of the last run are kept
  --cache DIR        where the root lies (default ${XDG_CACHE_HOME:-$HOME/.cache}/stratalux/arm64-N)
  --debs DIR         keep the packages for arm64 there
  -j N               compile and test with N processes (default: all processors)
  ctest argument     what ctest shall run; without any: the unit tests of shared, db and the controller, and the kernels of the fitter
CCACHE_DIR=DIR       with ccache, which is then installed in the root, and its objects in DIR
Needs root and mmdebstrap (scripts/install-deps.sh); packages come from the mirror of this machine's own apt.
Exit 77: nothing was tested, for one of these is missing.
examples:
  sudo scripts/test-arm64.sh
  sudo scripts/test-arm64.sh 12 --debs packages
  sudo scripts/test-arm64.sh 12 -R EmAgreement
HELP
}
source=$(cd "$(dirname "$0")/.." && pwd)
. "$source/scripts/debian-root.sh"
release=12 fresh=0 cache="" jobs=$(nproc) debs="" select=()
case "${1:-}" in [0-9]*) release=$1; shift ;; esac
codename=$(codename_of "$release")
while [ $# -gt 0 ]; do
  case "$1" in
    --fresh) fresh=1; shift ;;
    --cache) cache=${2:?--cache needs a folder}; shift 2 ;;
    --debs) debs=${2:?--debs needs a folder}; shift 2 ;;
    -j) jobs=${2:?-j needs a number}; shift 2 ;;
    -h|--help) usage; exit 0 ;;
    *) select+=("$1"); shift ;;
  esac
done
# Left out: what needs a kernel or devices of its own, what is killed by the thousand, the fuzzers' kept inputs; times, waits
# for a face or a picture, and resident memory, which are the emulator's; and what forks a program with threads, or meets
# its signals, at which qemu-user 7.2 itself fails.
left_out='Crash|Kill|Mutant|Soak|LightOff|^fuzz|WithinASecond|MemoryIsFlat|Population.TheNumbersAreWhereTheFitEnds'
left_out+='|LivePreviewTest|KioskTest.(AnIllLitFace|ACaptureThatWasNotBegun)'
left_out+='|LastResort|Logger.(AChildOfFork|WhatIsSaidStands|AForkAmid)|KioskForgetting.AWholeSession'
[ ${#select[@]} -gt 0 ] || select=(-L '^unit$' -E "$left_out")

[ "$(id -u)" -eq 0 ] || skip "a root of Debian is mounted and entered, which needs root: sudo scripts/test-arm64.sh $release"
take_cache "${cache:-${XDG_CACHE_HOME:-$HOME/.cache}/stratalux/arm64-$release}"
if [ $fresh -eq 1 ] || [ ! -d "$root" ]; then make_root; fi
copy_sources "$source"
install_deps rig,fit,test,pack --cross arm64
in_root apt-get clean
# shellcheck disable=SC2016
in_root bash -c '
  set -e
  jobs=$1
  shift
  cd /stratalux
  bin=build/arm64/bin
  for wrapped in "$bin"/*.arm64; do [ ! -e "$wrapped" ] || mv "$wrapped" "${wrapped%.arm64}"; done
  cmake --preset arm64
  cmake --build --preset arm64 -j "$jobs" --target programs tests/shared/all tests/db/all tests/firmware-host/all fitter_mixture_tests fitter_render_tests
  scripts/package.sh --no-install --built build/arm64 --out /debs
  # Tests start programs as a user does, and this kernel starts none of arm64.
  for program in "$bin"/*; do
    case "$program" in *_tests|*_test) continue ;; esac
    aarch64-linux-gnu-readelf -h "$program" 2>/dev/null | grep -q AArch64 || continue
    mv "$program" "$program.arm64"
    printf "#!/bin/sh\nexec qemu-aarch64 %s \"\$@\"\n" "$PWD/$program.arm64" >"$program"
    chmod +x "$program"
  done
  store=$(mktemp -d)
  "$bin/stratalux-rig" capture --simulate --size 348x260 --store "$store/store" --seed 1 2>&1 | tail -n 1
  "$bin/stratalux-db" verify --deep --store "$store/store"
  rm -rf "$store"
  exec ctest --test-dir build/arm64 --output-on-failure --timeout 1200 -j "$jobs" "$@"' test-arm64 "$jobs" "${select[@]}"
if [ -n "$debs" ]; then mkdir -p "$debs" && cp "$root"/debs/stratalux-*.deb "$debs/"; fi
