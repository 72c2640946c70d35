#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# From nothing to a face under new light: installs, builds, calibrates the simulated rig, captures a visitor with it, fits,
# renders, writes a report.
set -euo pipefail
usage() {
  cat <<'HELP'
usage: scripts/demo.sh [--out DIR] [--seed N] [--size WxH] [--no-install]
  --out DIR      where store and report go (default demo-out)
  --seed N       another face and another skin (default 1)
  --size WxH     camera mosaic (default 696x520; the full camera has 1392x1042)
  --no-install   do not look for missing Debian packages
examples:
  scripts/demo.sh
  scripts/demo.sh --out /tmp/demo --seed 7
HELP
}
root=$(cd "$(dirname "$0")/.." && pwd)
out=demo-out seed=1 size=696x520 install=1
while [ $# -gt 0 ]; do
  case "$1" in
    --out) out=${2:?--out needs a folder}; shift 2 ;;
    --seed) seed=${2:?--seed needs a number}; shift 2 ;;
    --size) size=${2:?--size needs WxH}; shift 2 ;;
    --no-install) install=0; shift ;;
    -h|--help) usage; exit 0 ;;
    *) echo "error: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
done
mkdir -p "$out"
out=$(cd "$out" && pwd)

[ $install -eq 0 ] || "$root/scripts/install-deps.sh"
cd "$root"
echo "building ..." >&2
cmake --preset release >"$out/configure.log" 2>&1 || { cat "$out/configure.log" >&2; exit 1; }
cmake --build --preset release --target programs >"$out/build.log" 2>&1 || { tail -n 50 "$out/build.log" >&2; exit 1; }
bin=$root/build/release/bin

start=$(date +%s)
store=$out/store
capture() { "$bin/stratalux-rig" capture --store "$store" --seed "$seed" --size "$size" "$@" >&2; }
"$bin/stratalux-db" init --store "$store" >&2

# The rig knows nothing of itself: its sessions name no calibration before there is one.
capture --kind calibration --simulate="$root/docs/examples/scenes/charuco_poses.toml" --calibration none
flat=$root/docs/examples/scenes/flat_poses.toml
capture --kind dark --simulate="$flat" --calibration none
for pose in 0 1 2; do capture --kind flat --pose $pose --simulate="$flat" --calibration none; done
capture --kind response --simulate="$flat" --calibration none
"$bin/stratalux-fit" calibrate --last 12 --target-albedo 0.99 --store "$store" >&2 || [ $? -eq 3 ]  # 3: accepted without some poses
"$bin/stratalux-db" query calibration-age --store "$store" >&2
calibrated=$(date +%s)

capture --simulate --calibration latest
captured=$(date +%s)
"$bin/stratalux-fit" run latest --store "$store" --full-evaluation >&2
end=$(date +%s)
echo "calibration $((calibrated - start)) s, capture $((captured - calibrated)) s, fit and report $((end - captured)) s" >&2
report=$("$bin/stratalux-fit" report latest --store "$store" --path-only)
echo "report: $report"
