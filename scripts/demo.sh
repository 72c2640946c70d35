#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# From nothing to a face under new light: installs, builds, calibrates the simulated rig, captures a visitor with it, fits,
# renders, writes a report. Or, with --kiosk: the kiosk in front of the same simulated rig.
set -euo pipefail
usage() {
  cat <<'HELP'
usage: scripts/demo.sh [--kiosk | --night N] [--out DIR] [--seed N] [--size WxH] [--no-install]
  --kiosk        the kiosk in place of a single visitor: its page's address is printed, Ctrl-C ends it
  --night N      N visitors of light to dark skin, fitted in a batch of which a worker is killed; ends with the morning's report
  --out DIR      where everything goes (default demo-out); its index.html is the page to open
  --seed N       another face and another skin (default 1)
  --size WxH     camera mosaic (default 696x520; the full camera has 1392x1042)
  --no-install   do not look for missing Debian packages
examples:
  scripts/demo.sh
  scripts/demo.sh --out /tmp/demo --seed 7
  scripts/demo.sh --kiosk
  scripts/demo.sh --night 6 --size 348x260
HELP
}
root=$(cd "$(dirname "$0")/.." && pwd)
out=demo-out seed=1 size=696x520 install=1 kiosk=0 night=0
while [ $# -gt 0 ]; do
  case "$1" in
    --out) out=${2:?--out needs a folder}; shift 2 ;;
    --seed) seed=${2:?--seed needs a number}; shift 2 ;;
    --size) size=${2:?--size needs WxH}; shift 2 ;;
    --no-install) install=0; shift ;;
    --kiosk) kiosk=1; shift ;;
    --night) night=${2:?--night needs a number}; shift 2
      [[ $night =~ ^[1-9][0-9]{0,3}$ ]] || { echo "error: --night $night: visitors, 1 .. 9999" >&2; exit 2; } ;;
    -h|--help) usage; exit 0 ;;
    *) echo "error: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
done
mkdir -p "$out"
out=$(cd "$out" && pwd)

[ $install -eq 0 ] || "$root/scripts/install-deps.sh" --groups rig,fit
cd "$root"
# Ninja's [done/all]: one line that counts for people, every fiftieth in a log; all of it in build.log.
count_steps() {
  local line
  while IFS= read -r line; do
    if [ -t 2 ]; then printf '\rbuilding %s ' "${line%%]*}]" >&2
    elif [[ $line =~ ^\[([0-9]*[05]0)/ ]]; then echo "building ${line%%]*}]" >&2; fi
  done
  if [ -t 2 ]; then echo >&2; fi
}
echo "building ..." >&2
cmake --preset programs >"$out/configure.log" 2>&1 || { cat "$out/configure.log" >&2; exit 1; }
cmake --build --preset programs 2>&1 | tee "$out/build.log" | count_steps || { tail -n 50 "$out/build.log" >&2; exit 1; }
bin=$root/build/programs/bin

if [ $kiosk -eq 1 ]; then
  [ -e "$out/operator-token" ] || (umask 077; od -An -N16 -tx1 /dev/urandom | tr -d ' \n' >"$out/operator-token")
  printf '[kiosk.page]\noperator_token_file = "%s"\n' "$out/operator-token" >"$out/rig.toml"
  echo "visitors: the address below; operators: /operator there, token $(cat "$out/operator-token")" >&2
  exec "$bin/stratalux-rig" kiosk --simulate --config "$out/rig.toml" --seed "$seed" --size "$size" --store "$out/kiosk-store" --page
fi

if [ "$night" -gt 0 ]; then
  store=$out/night-store
  for ((i = 0; i < night; ++i)); do
    # Each seed is somebody else of the simulated population: another head, another skin, light to dark.
    "$bin/stratalux-rig" capture --simulate --exposure auto --store "$store" --seed $((seed + i)) --size "$size" >&2 ||
      [ $? -eq 3 ]  # 3: degraded, with its findings; a night fits such visitors, too
  done
  "$bin/stratalux-fit" batch plan --store "$store" >&2
  # Whoever is being fitted when somebody pulls the plug loses a moment's work: stages that are finished stay.
  "$bin/stratalux-fit" batch run --store "$store" >"$out/night.txt" &
  batch=$! worker=
  # What runs beside a script does not hear an interruption of it.
  trap 'kill -TERM "$batch" 2>/dev/null; wait "$batch"; exit 130' INT TERM
  for ((tries = 0; tries < 600; ++tries)); do
    read -r worker _ <"/proc/$batch/task/$batch/children" || true
    if [ -n "$worker" ] && compgen -G "$store/sessions/*/artifacts/srd-*" >/dev/null; then
      echo "killing worker $worker" >&2
      kill -KILL "$worker" 2>/dev/null || true
      break
    fi
    kill -0 "$batch" 2>/dev/null || break
    sleep 0.1
  done
  status=0
  wait "$batch" || status=$?
  trap - INT TERM
  "$bin/stratalux-fit" batch report --store "$store" --text >&2
  cat "$out/night.txt"
  exit $status
fi

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
relight() { "$bin/stratalux-fit" render latest --store "$store" --out "$out/relit/$1" "${@:2}" >&2; }
relight evening --direction=1,-0.3,-0.4 --colour 1,0.8,0.6
relight lamp --point=-200,-150,250
relight line --projector 3 --pattern 'comb columns period=128 width=2 shift=0'

cat >"$out/index.html" <<HTML
<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Stratalux: the demo</title>
<meta name="viewport" content="width=device-width">
<style>
  body { font: 16px/1.5 system-ui, sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em }
  figure { display: inline-block; margin: 0 1em 1em 0 } img { width: 18em; background: #000 } code { background: #eee }
</style>
<h1>A face, measured and put under new light</h1>
<p>A simulated rig calibrated itself with boards and a white target ($((calibrated - start)) s), captured visitor $seed
($((captured - calibrated)) s) and fitted 20 scattering layers to every pixel ($((end - captured)) s).</p>
<p><a href="${report#"$out"/}">The report</a>: pictures of every stage, the light of a projector that the fit never saw, and all figures.</p>
<h2>Under light that nobody captured</h2>
<figure><img src="relit/evening/total.png" alt="The face in low, warm light from the right"><figcaption>Low, warm sun</figcaption></figure>
<figure><img src="relit/lamp/total.png" alt="The face beside a near lamp"><figcaption>A lamp beside the face</figcaption></figure>
<figure><img src="relit/line/total.png" alt="Thin lines of light that spread in the skin"><figcaption>Lines that spread in the skin</figcaption></figure>
<p>More: <code>$bin/stratalux-fit render latest --store $store --help</code></p>
</html>
HTML
echo "page: $out/index.html"
