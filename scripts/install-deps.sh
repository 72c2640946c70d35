#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs what Stratalux needs from Debian 12 or 13. One list, a purpose each; used by demo.sh, test.sh and the docs.
#   scripts/install-deps.sh                 install what is missing
#   scripts/install-deps.sh --list          print the packages of this release, their group and what each is for
#   scripts/install-deps.sh --rig           only what the controller needs
#   scripts/install-deps.sh --groups G,...  only these groups
#   scripts/install-deps.sh --groups G,... --cross arm64   their libraries for that architecture, its compiler and emulator
#   scripts/install-deps.sh --peers         also what benchmarks compare with and nothing else needs
set -euo pipefail

# PACKAGE@N: of Debian N alone. Whatever names no release of Debian counts as one that is newer than all of them.
release=$(. /etc/os-release && [ "${ID:-}" = debian ] && echo "${VERSION_ID:-new}" || echo new)
packages() {
  awk -v release="$release" '{ split($1, name, "@") } name[2] == "" || name[2] == release { sub(/@[0-9]+/, ""); print }' <<'LIST'
build-essential      rig  compiler and make
cmake                rig  build system
ninja-build          rig  build tool of the presets
pkg-config           rig  finds libxxhash, libsodium and libzstd
libeigen3-dev        rig  small vectors, rotations
libpng-dev           rig  PNG files
libjpeg-dev          rig  the kiosk's live picture
libqrencode-dev      rig  QR codes of the kiosk's tickets
libsqlite3-dev       rig  the store's index
libtiff-dev          rig  import and export of TIFF files by stratalux-db and stratalux-fit (the controller does not link it); peer in benchmarks
rsync                rig  stratalux-db pull
openssh-client       rig  stratalux-db pull from another machine
libtomlplusplus-dev  rig  configuration files
nlohmann-json3-dev   rig  manifests, calibration records, metrics
libcli11-dev         rig  command lines
libxxhash-dev        rig  XXH3-128 hashes of frames
libsodium-dev        rig  encryption of frames
libzstd-dev          rig  compression of frames and of the skin table
libmicrohttpd-dev    rig  the HTTP server of the kiosk's page and of stratalux-db serve
libdrm-dev           rig  projectors that are displays (KMS)
libcamera-dev        rig  cameras behind libcamera; without it that back-end is left out
libgpiod-dev         rig  the rig's digital lines
libopenexr-dev       fit  float maps as EXR
libceres-dev         fit  bundle adjustment of the calibration
libhwy-dev           fit  EM kernels for the machine's instruction set (Highway)
libopencv-dev        fit  chessboards and first guesses of the calibration
libopencv-contrib-dev fit ChArUco boards
libgtest-dev         test GoogleTest
libgmock-dev         test GoogleTest's matchers
libbenchmark-dev     test benchmarks (preset bench)
sqlite3              test the views and named queries in a shell that knows nothing of ours
systemd              test systemd-analyze, systemd-sysusers and systemd-tmpfiles hold the units of systemd/
udev                 test udevadm holds the rules of systemd/
clang-format         test the format check
clang                test libFuzzer, for the night part fuzz; without it that part is skipped
chromium             web  the store's and the kiosk's page in a real browser (label web)
chromium-driver      web  drives it
python3-selenium     web  drives it
fonts-ipafont-gothic web  Japanese letters of the kiosk's page
cage                 web  shows the kiosk's page on the visitor's screen, as stratalux-display.service does
xwayland             web  cage of Debian 12 does not start without it
xvfb                 web  the display on which the tests look at that screen
grim                 web  a picture of what cage shows
npm                  web  fetches axe-core, the accessibility checks of the page, and the validator of glTF files (npm ci)
qemu-system-x86      vm   emulator of the tests with the label vm (docs/rig-vm.md)
busybox-static       vm   shell of the guest
cpio                 vm   the guest's first file system
kmod                 vm   depmod and modprobe for the guest's modules
xz-utils             vm   the kernel's source is an xz archive
parallel             cluster a night by GNU parallel (docs/batch.md), in a test; none of ours runs it
snakemake            cluster the same by Snakemake
slurm-wlm            cluster a real Slurm on loopback: `stratalux-fit batch submit` in a test; a cluster has its own
munge                cluster by which its daemons know each other
mmdebstrap           night scripts/test-debian.sh: a root of another release (docs/night.md)
crossbuild-essential-arm64 cross compiler of the preset arm64
qemu-user            cross runs its programs on this machine
dpkg-dev             pack dpkg-shlibdeps: which package has which library of ours
gnupg                pack scripts/package.sh --sign
lintian              pack holds the packages against Debian's policy
mandoc               test reads the manual pages closely
man-db               test as their readers do
zsh                  test the completions for zsh
fish                 test the completions for fish
git                  test the style checks list the tracked files
libarmadillo-dev     peer em_bench: gmm_diag; without it that peer is left out
python3-sklearn      peer tests/bench/mixture/em_sklearn.py: GaussianMixture
LIST
}

architecture=""
case "${3:-}" in
  "") ;;
  --cross) architecture=${4:?--cross needs an architecture}
    [ "$architecture" = arm64 ] || { echo "error: --cross $architecture: only arm64 is supported" >&2; exit 2; } ;;
  *) echo "error: '$3' is not known" >&2; exit 2 ;;
esac
case "${1:-}" in
  --list) packages; exit 0 ;;
  --rig) wanted=$(packages | awk '$2=="rig"{print $1}') ;;
  --groups) wanted=$(packages | awk -v groups=",${2:?--groups needs G,...}," 'index(groups, "," $2 ",") {print $1}') ;;
  --peers) wanted=$(packages | awk '$2!="cross"{print $1}') ;;
  "") wanted=$(packages | awk '$2!="peer" && $2!="cross"{print $1}') ;;
  *) echo "usage: scripts/install-deps.sh [--list|--rig|--groups G,... [--cross arm64]|--peers]" >&2; exit 2 ;;
esac

sudo=""
[ "$(id -u)" -eq 0 ] || ! command -v sudo >/dev/null || sudo=sudo
# Headers that fit every architecture come in packages of none; programs are this machine's.
if [ -n "$architecture" ]; then
  dpkg --print-foreign-architectures | grep -qx "$architecture" || { $sudo dpkg --add-architecture "$architecture"; $sudo apt-get update -qq; }
  foreign=()
  for package in $wanted; do
    case "$package" in
      lib*-dev) [[ $(apt-cache show --no-all-versions "$package:$architecture" 2>/dev/null) != *"Architecture: $architecture"* ]] || package+=:$architecture ;;
    esac
    foreign+=("$package")
  done
  wanted="${foreign[*]} $(packages | awk '$2=="cross"{print $1}')"
fi

missing=()
for package in $wanted; do
  # Node's own packages bring npm themselves and exclude Debian's.
  [ "$package" != npm ] || ! command -v npm >/dev/null || continue
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then exit 0; fi

echo "installing: ${missing[*]}" >&2
[ "$(id -u)" -eq 0 ] || [ -n "$sudo" ] || { echo "error: run as root or install sudo; missing: ${missing[*]}" >&2; exit 1; }
$sudo apt-get update -qq || echo "warning: package lists could not be refreshed" >&2
$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >&2
