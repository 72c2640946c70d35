#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The Debian packages of a build folder, looked at without being installed (scripts/test-packages.sh installs them): who
# depends on what, what lies where, what lintian says, and that the same build gives the same bytes. Exit 77: a tool is missing.
#   check-packages.sh SOURCE BUILD
set -euo pipefail
source=$1 build=$2
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
fail() { printf 'FAILED: %s\n' "$@" >&2; exit 1; }
for tool in dpkg-shlibdeps lintian gpg; do
  command -v $tool >/dev/null || { echo "skipped: $tool is not installed: scripts/install-deps.sh" >&2; exit 77; }
done
export GNUPGHOME=$scratch/gnupg
mkdir -m 700 "$GNUPGHOME"
gpg --batch --quiet --passphrase '' --quick-generate-key 'Rig Team <rig@lab.stratalux.org>' >/dev/null 2>&1 || fail "a key to sign with"
trap 'gpgconf --kill all 2>/dev/null || true; rm -rf "$scratch"' EXIT

pack() { "$source/scripts/package.sh" --built "$build" --no-install --maintainer 'Rig Team <rig@lab.stratalux.org>' --out "$@" >"$scratch/log" 2>&1 || { cat "$scratch/log"; fail "scripts/package.sh"; }; }
pack "$scratch/debs" --sign rig@lab.stratalux.org
cd "$scratch/debs"
deb() { echo "$scratch/debs/$1"_*.deb; }
field() { dpkg-deb -f "$(deb "$1")" "$2"; }
version=$(field stratalux-data Version)

for package in stratalux-data stratalux-db stratalux-rig stratalux-fit; do
  [ -f "$(deb $package)" ] || fail "no package $package"
  [ "$(field $package Version)" = "$version" ] || fail "$package is of another version"
  dpkg-deb -c "$(deb $package)" >"$scratch/files"
  ! awk '{print $6}' "$scratch/files" | grep -vE '^\./(usr/.*|etc/|etc/stratalux/.*)?$' || fail "$package has files elsewhere"
  ! awk '$2 != "root/root"' "$scratch/files" | grep . || fail "$package has files that are not root's"
  for file in "doc/$package/copyright" "doc/$package/changelog.Debian.gz"; do
    grep -q " ./usr/share/$file\$" "$scratch/files" || fail "$package lacks $file"
  done
  [ $package = stratalux-data ] || [[ $(field $package Depends) == *"stratalux-data (= $version)"* ]] || fail "$package does not belong to its data"
done
# What the controller's computer is spared; that the fitter has it shows that this looks at the right thing.
heavy='libopencv|libceres|libglog|libcholmod|libopenexr|slurm'
! field stratalux-rig Depends | grep -E "$heavy|libtiff" || fail "the controller depends on what only others need"
[[ $(field stratalux-fit Depends) == *libopencv-calib3d*libopenexr* ]] || fail "the fitter's libraries are not found: $(field stratalux-fit Depends)"
[[ $(field stratalux-rig Depends) == *libgpiod* ]] || fail "the controller's libraries are not found"
dpkg-deb -I "$(deb stratalux-data)" conffiles | grep -x /etc/stratalux/rig.toml >/dev/null || fail "/etc/stratalux/rig.toml is no conffile"
dpkg-deb --fsys-tarfile "$(deb stratalux-data)" | tar -xO ./etc/stratalux/rig.toml | grep -x 'store = "/var/lib/stratalux/store"[ ]*' >/dev/null || fail "the shipped configuration names no store"
for file in man/man1/stratalux-rig.1.gz bash-completion/completions/stratalux-rig zsh/vendor-completions/_stratalux-rig fish/vendor_completions.d/stratalux-rig.fish; do
  dpkg-deb -c "$(deb stratalux-rig)" | grep " ./usr/share/$file\$" >/dev/null || fail "stratalux-rig lacks $file"
done
for file in page/index.html languages/en.json; do
  dpkg-deb -c "$(deb stratalux-rig)" | grep " ./usr/share/stratalux/kiosk/$file\$" >/dev/null || fail "stratalux-rig lacks the kiosk's $file"
done
dpkg-deb --fsys-tarfile "$(deb stratalux-rig)" | tar -xO ./usr/lib/systemd/system/stratalux-safe.service | grep '^ExecStart=/usr/bin/stratalux-rig safe' >/dev/null || fail "a unit does not name /usr/bin"

lintian --allow-root --fail-on error,warning --tag-display-limit 0 ./*.deb >"$scratch/lintian" 2>&1 || { cat "$scratch/lintian"; fail "lintian"; }

gpg --quiet --verify SHA256SUMS.asc SHA256SUMS 2>/dev/null || fail "the signature is not good"
sha256sum --quiet --check SHA256SUMS || fail "SHA256SUMS does not fit"
[ "$(wc -l <SHA256SUMS)" -eq 4 ] || fail "SHA256SUMS does not name four packages"
sed 's/^./0/' SHA256SUMS >changed
! gpg --quiet --verify SHA256SUMS.asc changed 2>/dev/null || fail "changed sums pass"

pack "$scratch/again"
cmp SHA256SUMS "$scratch/again/SHA256SUMS" || fail "the same build gives other packages"
ls -l ./*.deb
