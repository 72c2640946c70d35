#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs this tree's packages in a clean root of a release of Debian, uses them, upgrades them with a live store, removes
# and purges them. The last line says what was tried.
set -euo pipefail
usage() {
  cat <<'HELP'
usage: scripts/test-packages.sh [12|13] [--debs DIR] [--fresh] [--cache DIR] [-j N]
  12, 13         the release of Debian (default 13)
  --debs DIR     packages of that release, made by scripts/package.sh; default: made here, in the root of scripts/test-debian.sh
  --fresh        make a new clean root; otherwise a copy of the last one is used
  --cache DIR    where the roots lie (default ${XDG_CACHE_HOME:-$HOME/.cache}/stratalux/debian-N and packages-N)
  -j N           compile with N processes (default: all processors)
Needs root and mmdebstrap (scripts/install-deps.sh); packages come from the mirror of this machine's own apt.
Exit 77: nothing was tested, for one of these is missing.
examples:
  sudo scripts/test-packages.sh
  scripts/package.sh --out debs && sudo scripts/test-packages.sh 12 --debs debs
HELP
}
source=$(cd "$(dirname "$0")/.." && pwd)
. "$source/scripts/debian-root.sh"
release=13 fresh=0 caches=${XDG_CACHE_HOME:-$HOME/.cache}/stratalux jobs=$(nproc) debs=""
case "${1:-}" in [0-9]*) release=$1; shift ;; esac
codename=$(codename_of "$release")
while [ $# -gt 0 ]; do
  case "$1" in
    --debs) debs=${2:?--debs needs a folder}; shift 2 ;;
    --fresh) fresh=1; shift ;;
    --cache) caches=${2:?--cache needs a folder}; shift 2 ;;
    -j) jobs=${2:?-j needs a number}; shift 2 ;;
    -h|--help) usage; exit 0 ;;
    *) echo "error: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
done
[ "$(id -u)" -eq 0 ] || skip "a root of Debian is mounted and entered, which needs root: sudo scripts/test-packages.sh $release"
[ -z "$debs" ] || debs=$(cd "$debs" && pwd)

# Two revisions of the same tree: an upgrade has something to go from.
if [ -z "$debs" ]; then
  take_cache "$caches/debian-$release"
  [ -d "$root" ] || make_root
  copy_sources "$source"
  install_deps rig,fit,pack
  for revision in 1 2; do
    in_root /stratalux/scripts/package.sh --no-install -j "$jobs" --revision "$revision" --out "/debs/$revision" >&2 || fail "the packages cannot be built"
  done
  debs=$root/debs
  flock --unlock 9
else
  mkdir -p "$caches"
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  mkdir "$work/1" "$work/2"
  cp "$debs"/stratalux-*.deb "$work/1/"
  # The same files under the next version, with all that names it.
  for deb in "$debs"/stratalux-*.deb; do
    dpkg-deb -R "$deb" "$work/tree"
    old=$(dpkg-deb -f "$deb" Version)
    sed -i "s/$old/$old.2/" "$work/tree/DEBIAN/control"
    dpkg-deb --root-owner-group -b "$work/tree" "$work/2/" >/dev/null
    rm -rf "$work/tree"
  done
  debs=$work
fi

take_cache "$caches/packages-$release"
if [ $fresh -eq 1 ] || [ ! -d "$cache/clean" ]; then
  make_root
  rm -rf "$cache/clean"
  mv "$root" "$cache/clean"
fi
rm -rf "$root"
cp -a --reflink=auto "$cache/clean" "$root"
cp -L /etc/resolv.conf "$root/etc/resolv.conf"
mkdir -p "$root/debs"
cp -r "$debs/1" "$debs/2" "$root/debs/"
cp "$source/tests/packages/in-root.sh" "$source/tests/support/smallest_plan.toml" "$root/debs/"
in_root apt-get update -qq >&2
in_root bash /debs/in-root.sh
rm -rf "$root"
