#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds and tests this tree on a release of Debian that the machine need not have: in a root made by mmdebstrap, with what
# install-deps.sh lists. ctest's closing line ends the output.
set -euo pipefail
usage() {
  cat <<'HELP'
usage: scripts/test-debian.sh [12|13] [--fresh] [--cache DIR] [-j N] [ctest argument ...]
  12, 13             the release of Debian (default 13)
  --fresh            make a new root; otherwise the packages and objects of the last run are kept
  --cache DIR        where the root lies (default ${XDG_CACHE_HOME:-$HOME/.cache}/stratalux/debian-N)
  -j N               compile and test with N processes (default: all processors)
  ctest argument     what ctest shall run; without -L: the labels unit and integration
CCACHE_DIR=DIR       with ccache, which is then installed in the root, and its objects in DIR
Needs root and mmdebstrap (scripts/install-deps.sh); packages come from the mirror of this machine's own apt.
Exit 77: nothing was tested, for one of these is missing. What is copied: the tracked files, as they are in the working tree.
examples:
  sudo scripts/test-debian.sh                  # Debian 13
  sudo scripts/test-debian.sh 12 --fresh
  sudo scripts/test-debian.sh 13 -R Charuco
  sudo scripts/test-debian.sh 13 -L web        # in the root's Chromium, which is then installed; likewise -L vm
HELP
}
source=$(cd "$(dirname "$0")/.." && pwd)
. "$source/scripts/debian-root.sh"
release=13 fresh=0 cache="" jobs=$(nproc) select=() labels="" groups=rig,fit,test
case "${1:-}" in [0-9]*) release=$1; shift ;; esac
codename=$(codename_of "$release")
while [ $# -gt 0 ]; do
  case "$1" in
    --fresh) fresh=1; shift ;;
    --cache) cache=${2:?--cache needs a folder}; shift 2 ;;
    -j) jobs=${2:?-j needs a number}; shift 2 ;;
    -L|--label-regex) labels+=" ${2:?$1 needs a label}"; select+=("$1" "$2"); shift 2 ;;
    -h|--help) usage; exit 0 ;;
    *) select+=("$1"); shift ;;
  esac
done
case "$labels" in *vm*) groups+=,vm ;; esac
case "$labels" in *web*) groups+=,web ;; esac
case "$labels" in *batch*) groups+=,cluster ;; esac

[ "$(id -u)" -eq 0 ] || skip "a root of Debian is mounted and entered, which needs root: sudo scripts/test-debian.sh $release"
if [ -z "$labels" ]; then
  select+=(-L '^(unit|integration)$')
  echo "left out: the labels soak, style, vm and web; -L selects them" >&2
fi
take_cache "${cache:-${XDG_CACHE_HOME:-$HOME/.cache}/stratalux/debian-$release}"
if [ $fresh -eq 1 ] || [ ! -d "$root" ]; then make_root; fi
copy_sources "$source"
install_deps "$groups"
in_root apt-get clean
in_root sh -c '. /etc/os-release && echo "$PRETTY_NAME, GCC $(gcc -dumpfullversion)"' >&2
# shellcheck disable=SC2016
in_root bash -c '
  set -e
  jobs=$1
  shift
  cd /stratalux
  cmake --preset release
  cmake --build --preset release -j "$jobs"
  exec ctest --test-dir build/release --output-on-failure -j "$jobs" "$@"' test-debian "$jobs" "${select[@]}"
