# shellcheck shell=bash
# SPDX-License-Identifier: Apache-2.0
# Roots of a release of Debian, made by mmdebstrap: for scripts/test-debian.sh, test-packages.sh and test-arm64.sh, which source it.
# $codename names the release, $cache the folder of one root, $root the root.
skip() { printf 'skipped: %s\n' "$@" >&2; exit 77; }
fail() { printf 'error: %s\n' "$@" >&2; exit 1; }

codename_of() {
  case "$1" in
    12) echo bookworm ;;
    13) echo trixie ;;
    *) echo "error: Debian $1 is not supported; supported: 12, 13" >&2; exit 2 ;;
  esac
}
# take_cache FOLDER: nobody else uses the root in it until this program ends.
take_cache() {
  cache=$1
  root=$cache/root
  mkdir -p "$cache"
  exec 9>"$cache/lock"
  flock --nonblock 9 || fail "another run is using $cache; wait for it or give --cache another folder"
}
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
  echo "making a root of Debian $codename in $root ..." >&2
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
# copy_sources FOLDER: its tracked files, as they are in the working tree, become the root's /stratalux.
copy_sources() {
  # By their contents: of what did not change, the objects stay good.
  tree=$(mktemp -d)
  trap 'rm -rf "$tree"' EXIT
  git -c safe.directory="$1" -C "$1" ls-files -z |
    rsync -a --from0 --files-from=- --ignore-missing-args "$1/" "$tree/" || fail "the tracked files of $1 cannot be listed and copied"
  rsync -rlp --checksum --delete --exclude=/build "$tree/" "$root/stratalux/"
  rm -rf "$tree"
}
# install_deps GROUP,... [--cross ARCHITECTURE]: of scripts/install-deps.sh, in the root.
install_deps() {
  cp -L /etc/resolv.conf "$root/etc/resolv.conf"
  find "$root/tmp" -mindepth 1 -delete
  in_root /stratalux/scripts/install-deps.sh --groups "$@" >"$cache/packages.log" 2>&1 ||
    { tail -n 20 "$cache/packages.log" >&2; fail "the packages cannot be installed, see $cache/packages.log; --fresh makes a new root"; }
  if [ -n "${CCACHE_DIR:-}" ] && [ ! -x "$root/usr/bin/ccache" ]; then
    in_root apt-get install -y -qq --no-install-recommends ccache >>"$cache/packages.log" 2>&1 || echo "warning: no ccache in the root" >&2
  fi
}
