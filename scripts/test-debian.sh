#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds and tests this tree on a release of Debian that the machine need not have: in a root made by mmdebstrap, with what
# install-deps.sh lists. ctest's closing line ends the output.
set -euo pipefail
usage() {
  cat <<'HELP'
usage: scripts/test-debian.sh [12|13] [--fresh] [--cache DIR] [-j N] [ctest argument ...]
  12, 13             the release of Debian (default 13)
  --fresh            make the root anew; otherwise the packages and objects of the last run are kept
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
skip() { printf 'skipped: %s\n' "$@" >&2; exit 77; }
fail() { printf 'error: %s\n' "$@" >&2; exit 1; }

source=$(cd "$(dirname "$0")/.." && pwd)
release=13 fresh=0 cache="" jobs=$(nproc) select=() labels="" groups=rig,fit,test
case "${1:-}" in [0-9]*) release=$1; shift ;; esac
case "$release" in
  12) codename=bookworm ;;
  13) codename=trixie ;;
  *) echo "error: Debian $release is not supported; supported: 12, 13" >&2; exit 2 ;;
esac
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

[ "$(id -u)" -eq 0 ] || skip "a root of Debian is mounted and entered, which needs root: sudo scripts/test-debian.sh $release"
if [ -z "$labels" ]; then
  select+=(-L '^(unit|integration)$')
  echo "left out: the labels soak, style, vm and web; -L asks for them" >&2
fi
cache=${cache:-${XDG_CACHE_HOME:-$HOME/.cache}/stratalux/debian-$release}
root=$cache/root
mkdir -p "$cache"
exec 9>"$cache/lock"
flock --nonblock 9 || fail "another run has $cache; wait for it or give --cache another folder"

# The mirror that this machine's apt takes Debian from, security updates apart.
mirror() {
  apt-get indextargets --format '$(LABEL) $(ORIGIN) $(COMPONENT) $(REPO_URI)' 'Created-By: Packages' |
    awk '$1 == "Debian" && $2 == "Debian" && $3 == "main" && $4 !~ /^cdrom:/ && !found++ {print $4}'
}
make_root() {
  local uri proxy="" options=() probe
  command -v mmdebstrap >/dev/null || skip "mmdebstrap is not installed: scripts/install-deps.sh"
  uri=$(mirror)
  [ -n "$uri" ] || skip "this machine's apt knows no mirror of Debian; see \`apt-get indextargets\` (after apt-get update)"
  probe=$(mktemp -d)
  /usr/lib/apt/apt-helper download-file "${uri%/}/dists/$codename/Release" "$probe/Release" >"$probe/log" 2>&1 ||
    { cat "$probe/log" >&2; rm -rf "$probe"; skip "the mirror $uri has no $codename or cannot be reached"; }
  rm -rf "$probe"
  eval "$(apt-config shell proxy Acquire::http::Proxy)"
  [ -z "$proxy" ] || options+=(--aptopt="Acquire::http::Proxy \"$proxy\"")
  rm -rf "${root:?}" "$root.new"
  echo "making a root of Debian $release in $root ..." >&2
  mmdebstrap --quiet --mode=root --variant=minbase --components=main --include=ca-certificates "${options[@]}" \
    "$codename" "$root.new" "$uri" >&2 ||
    fail "mmdebstrap failed, see above; a keyring that is too old for $codename: apt-get install debian-archive-keyring"
  mv "$root.new" "$root"
}
# in_root COMMAND ...: in the root, with nothing of our environment. Its mounts go with it.
in_root() {
  unshare --mount --propagation private bash -c '
    set -e
    root=$1 objects=$2
    shift 2
    mount -t proc proc "$root/proc"
    mount --rbind /sys "$root/sys"
    mount --rbind /dev "$root/dev"
    [ -z "$objects" ] || { mkdir -p "$root/ccache" "$objects"; mount --bind "$objects" "$root/ccache"; }
    exec env -i HOME=/root LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive \
      CCACHE_DIR=/ccache CCACHE_SLOPPINESS=pch_defines,time_macros chroot "$root" "$@"' \
    in-root "$root" "${CCACHE_DIR:-}" "$@"
}

if [ $fresh -eq 1 ] || [ ! -d "$root" ]; then make_root; fi
# By their contents: of what did not change, the objects stay good.
tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
git -c safe.directory="$source" -C "$source" ls-files -z |
  rsync -a --from0 --files-from=- --ignore-missing-args "$source/" "$tree/" || fail "the tracked files of $source cannot be listed and copied"
rsync -rlp --checksum --delete --exclude=/build "$tree/" "$root/stratalux/"
rm -rf "$tree"
cp -L /etc/resolv.conf "$root/etc/resolv.conf"
find "$root/tmp" -mindepth 1 -delete

in_root /stratalux/scripts/install-deps.sh --groups "$groups" >"$cache/packages.log" 2>&1 ||
  { tail -n 20 "$cache/packages.log" >&2; fail "the packages cannot be installed, see $cache/packages.log; --fresh makes the root anew"; }
if [ -n "${CCACHE_DIR:-}" ] && [ ! -x "$root/usr/bin/ccache" ]; then
  in_root apt-get install -y -qq --no-install-recommends ccache >>"$cache/packages.log" 2>&1 || echo "warning: no ccache in the root" >&2
fi
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
