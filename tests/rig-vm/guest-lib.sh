# SPDX-License-Identifier: Apache-2.0
# What the jobs share; sourced by them in the guest.
failures=0
cases=/share/cases

# run_tests PROGRAM FILTER: GoogleTest cases of /build/bin/PROGRAM, a line each. One that skips itself failed: here its
# device is present.
run_tests() {
  local log=/share/$1.log status
  "/build/bin/$1" --gtest_color=no --gtest_filter="$2" >"$log" 2>&1
  status=$?
  sed -nE 's/^\[       OK \] ([^ ]+) .*/ok      \1/p; s/^\[  SKIPPED \] ([^ ]+) \(.*/FAILED  \1 (skipped)/p
           s/^\[  FAILED  \] ([^ ]+) \(.*/FAILED  \1/p' "$log" >/tmp/tests
  cat /tmp/tests >>$cases
  if [ "$status" -ne 0 ] || [ ! -s /tmp/tests ] || grep -q '^FAILED' /tmp/tests; then
    printf 'FAILED  %s: exit %s\n' "$1" "$status" >>$cases
    grep -v '^\[ RUN' "$log" | tail -n 60 | sed 's/^/        /' >>$cases
    failures=$((failures + 1))
  fi
}
# judge NAME COMMAND...: a case that passes where the command succeeds.
judge() {
  local name="$1"
  shift
  if "$@"; then printf 'ok      %s\n' "$name" >>$cases; return; fi
  printf 'FAILED  %s\n' "$name" >>$cases
  failures=$((failures + 1))
}
finish() { [ "$failures" -eq 0 ]; exit; }

# start_udev: libcamera learns of devices from it.
start_udev() {
  /lib/systemd/systemd-udevd --daemon
  udevadm trigger --type=subsystems
  udevadm trigger
  udevadm settle -t 20
}

# make_lines LABEL NAME...: a simulated chip with these lines. remove_lines LABEL: it is unplugged.
make_lines() {
  local at=/sys/kernel/config/gpio-sim/$1/bank0 line=0 name
  mkdir -p "$at"
  echo "$1" >"$at/label"
  shift
  echo $# >"$at/num_lines"
  for name in "$@"; do
    mkdir "$at/line$line"
    echo "$name" >"$at/line$line/name"
    line=$((line + 1))
  done
  echo 1 >"$at/../live"
}
remove_lines() {
  local at=/sys/kernel/config/gpio-sim/$1
  echo 0 >"$at/live"
  rmdir "$at"/bank0/line* "$at/bank0" "$at"
}

# gpiod's own programs, whose second version holds a line where the first lets go of it, and has another syntax.
gpiod_is_2() { gpioset --version | grep -q ' v2'; }
chip_named() { gpiodetect | awk -v label="[$1]" 'index($0, label) {print $1; exit}'; }
# leave_lines LABEL OFFSET=VALUE...: written by a program that then ends. hold_lines: by one that goes on, in the background.
leave_lines() {
  local chip
  chip=$(chip_named "$1")
  shift
  if gpiod_is_2; then gpioset --toggle 0 --chip "$chip" "$@"; else gpioset "$chip" "$@"; fi
}
hold_lines() {
  local chip
  chip=$(chip_named "$1")
  shift
  if gpiod_is_2; then gpioset --chip "$chip" "$@" & else gpioset --mode=signal "$chip" "$@" & fi
}

# values_of FILE: each value of a JSON file as `stratalux-*` indents it, a line: "cards..connectors..name Virtual-1".
# Elements of arrays have no name.
values_of() {
  awk '{match($0, /^ */); depth = RLENGTH / 2; text = substr($0, RLENGTH + 1); name[depth] = ""
    if (match(text, /^"[^"]*": /)) {name[depth] = substr(text, 2, RLENGTH - 4); text = substr(text, RLENGTH + 1)}
    sub(/,$/, "", text)
    if (text ~ /^[][{}]+$/) next
    gsub(/^"|"$/, "", text)
    path = name[1]
    for (i = 2; i <= depth; i++) path = path "." name[i]
    print path " " text}' "$1"
}

# load_camera: vivid anew, its output looped to its capture side; sets `camera` and `screen`. set_camera: one that is
# there.
load_camera() {
  modprobe -r vivid 2>/dev/null
  modprobe vivid n_devs=1 node_types=0x101 num_inputs=1 input_types=0x3 num_outputs=1 output_types=0x1
  set_camera
}
set_camera() {
  camera=$(v4l2_node vid-cap) screen=$(v4l2_node vid-out)
  # 30 frames a second: what the emulator can take.
  for node in "$camera" "$screen"; do v4l2-ctl -d "$node" --set-dv-bt-timings cvt,width=800,height=600,fps=30; done >/dev/null 2>&1
  v4l2-ctl -d "$camera" -c "$(looped),osd_text_mode=2,timestamp_source=1"
}
# What loops vivid's output to its input. Since Linux 6.11 a menu of the input names the output at the cable's other end, the
# last entry here; before, a switch looped them.
looped() {
  v4l2-ctl -d "$camera" --list-ctrls-menus | awk '
    / 0x[0-9a-f]+ \(/ {in_menu = 0}
    $1 == "loop_video" {print "loop_video=1"; found = 1}
    $1 ~ /^hdmi_.*is_connected_to$/ {name = $1; in_menu = 1}
    in_menu && $1 ~ /^[0-9]+:$/ {last = $1 + 0}
    END {if (!found && name) print name "=" last}'
}
v4l2_node() { echo /dev/"$(basename "$(dirname "$(grep -l "$1" /sys/class/video4linux/*/name)")")"; }

# sample N SEED: N of the lines given, in their order.
sample() {
  awk -v wanted="$1" -v seed="$2" '{line[NR] = $0}
    END {srand(seed); for (i = 1; i <= NR; i++) if (rand() * (NR - i + 1) < wanted) {print line[i]; wanted--}}'
}
option() { sed -nE "s/.*rig\.$1=([0-9]+).*/\1/p" /proc/cmdline; }
