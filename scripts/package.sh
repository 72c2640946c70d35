#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds the Debian packages of this tree, for the release of Debian that it runs on.
set -euo pipefail
usage() {
  cat <<'HELP'
usage: scripts/package.sh [--out DIR] [--revision R] [--maintainer 'NAME <MAIL>'] [--sign KEYID]
                          [--preset P | --built DIR] [--no-install] [-j N]
  --out DIR        where the packages go, with SHA256SUMS (default: packages)
  --revision R     what follows the version (default: 1~deb12u1 on Debian 12, so that an upgrade of Debian upgrades them)
  --maintainer M   in the packages (default: $DEBFULLNAME <$DEBEMAIL>, where set)
  --sign KEYID     signs SHA256SUMS by gpg with that key, as SHA256SUMS.asc
  --preset P       what is built (default: programs; rig: without the fitter)
  --built DIR      packages that build folder as it is
  --no-install     do not look for missing Debian packages
  -j N             compile with N processes (default: all processors)
examples:
  scripts/package.sh
  scripts/package.sh --out /srv/packages --sign 0xE09315C4 --maintainer 'Rig Team <rig@lab.example.org>'
  cd packages && gpg --verify SHA256SUMS.asc SHA256SUMS && sha256sum --check SHA256SUMS && sudo apt-get install ./*.deb
The same sources, compiler and revision give the same bytes ($SOURCE_DATE_EPOCH; default: the last commit's time).
HELP
}
fail() { printf 'error: %s\n' "$@" >&2; exit 1; }

root=$(cd "$(dirname "$0")/.." && pwd)
out=packages revision="" maintainer="" key="" preset=programs built="" install=1 jobs=$(nproc)
while [ $# -gt 0 ]; do
  case "$1" in
    --out) out=${2:?--out needs a folder}; shift 2 ;;
    --revision) revision=${2:?--revision needs a text}; shift 2 ;;
    --maintainer) maintainer=${2:?--maintainer needs a name and an address}; shift 2 ;;
    --sign) key=${2:?--sign needs a key}; shift 2 ;;
    --preset) preset=${2:?--preset needs a name}; shift 2 ;;
    --built) built=${2:?--built needs a folder}; shift 2 ;;
    --no-install) install=0; shift ;;
    -j) jobs=${2:?-j needs a number}; shift 2 ;;
    -h|--help) usage; exit 0 ;;
    *) echo "error: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
done
[[ -z $maintainer || $maintainer =~ ^[^\<]+\ \<[^@]+@[^@]+\>$ ]] || { echo "error: --maintainer '$maintainer': expected NAME <MAIL>" >&2; exit 2; }
[[ -z $revision || $revision =~ ^[A-Za-z0-9+.~]+$ ]] || { echo "error: --revision '$revision': only letters, digits, + . ~" >&2; exit 2; }
[ -z "$key" ] || gpg --list-secret-keys "$key" >/dev/null 2>&1 || fail "--sign $key: gpg has no such secret key (gpg --list-secret-keys)"
mkdir -p "$out"
out=$(cd "$out" && pwd)
[ -z "$built" ] || built=$(cd "$built" && pwd)  # from where the user stands
[ $install -eq 0 ] || "$root/scripts/install-deps.sh" --groups rig,fit,pack

release=$(. /etc/os-release && echo "${VERSION_ID:-0}")
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git -c safe.directory="$root" -C "$root" log -1 --format=%ct 2>/dev/null || stat -c %Y "$root/CHANGELOG.md")}
export SOURCE_DATE_EPOCH
settings=(-D CPACK_STRATALUX_REVISION="${revision:-1~deb${release}u1}" -D CPACK_STRATALUX_DATE="$(date -uR -d "@$SOURCE_DATE_EPOCH")")
[ -n "$maintainer" ] || [ -z "${DEBEMAIL:-}" ] || maintainer="${DEBFULLNAME:-$DEBEMAIL} <$DEBEMAIL>"
[ -z "$maintainer" ] || settings+=(-D CPACK_STRATALUX_MAINTAINER="$maintainer")

cd "$root"
log=$(mktemp -d)
trap 'rm -rf "$log"' EXIT
told() { "$@" >"$log/said" 2>&1 || { tail -n 50 "$log/said" >&2; fail "${*:1:2} failed, see above"; }; }
if [ -z "$built" ]; then
  built=build/$preset
  echo "building ..." >&2
  told cmake --preset "$preset"
  told cmake --build "$built" -j "$jobs" --target programs
fi
echo "packaging ..." >&2
told cpack --config "$built/CPackConfig.cmake" "${settings[@]}" -B "$log/packages"
rm -f "$out"/stratalux-*.deb "$out"/SHA256SUMS "$out"/SHA256SUMS.asc
mv "$log"/packages/*.deb "$out/"
cd "$out"
sha256sum stratalux-*.deb >SHA256SUMS
[ -z "$key" ] || gpg --batch --yes --local-user "$key" --armor --detach-sign --output SHA256SUMS.asc SHA256SUMS || fail "gpg could not sign with $key"
ls "$out"/stratalux-*.deb
