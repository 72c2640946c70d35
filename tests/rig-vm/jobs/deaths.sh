#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# `stratalux-rig capture` on the kernel's interfaces dies, is stopped or stalls, at a moment drawn by `rig.seed`:
# `rig.faults` of the ways below. Each time the kernel's trace must tell of every ENABLE line that its last write was
# off, by the program, and read back since; nothing lights up later, and the store opens with the session failed.
#   death | ms after the first light | exit | session | lights: times on, last write, last reading
. /source/tests/rig-vm/guest-lib.sh

plan=/tmp/short.toml  # references, codes and guards
sed 's/^kind = "visitor"/kind = "calibration"/' /source/tests/rig-vm/plans/loop.toml >$plan
export STATE_DIRECTORY=/tmp/state
mkdir -p "$STATE_DIRECTORY"
tracing=/sys/kernel/tracing/instances/deaths  # the responder takes what it reads from the first one
disk=/tmp/disk                                # a file system of its own: the share and the root never stand still
disk_mib=96
limit_s=180                                   # of each wait: a busy machine's emulator takes minutes

pull() {  # LINE up|down: what the world outside puts on it
  echo "pull-$2" >"$chip/sim_gpio$(line_of "$1")/pull"
}
line_of() { basename "$(dirname "$(grep -lx "$1" /sys/kernel/config/gpio-sim/rig-lines/bank0/line*/name)")" | tr -cd 0-9; }
enables() { cat "$chip/sim_gpio$(line_of ENABLE0)/value" "$chip/sim_gpio$(line_of ENABLE1)/value"; }
alive() { kill -0 "$pid" 2>/dev/null; }
# soon COMMAND...: until it succeeds; fails after the limit
soon() {
  local end=$(($(now_ms) + limit_s * 1000))
  until "$@"; do
    [ "$(now_ms)" -lt "$end" ] || return 1
    usleep 50000
  done
}
now_ms() { awk '{printf "%d", $1 * 1000}' /proc/uptime; }
lit() { ! alive || enables | grep -q 1; }
gone() { ! alive; }
# Between two projectors it is dark for a moment; here nothing may come for three seconds.
dark() {
  local i
  for i in 1 2 3 4 5 6; do
    ! enables | grep -q 1 || return 1
    usleep 500000
  done
}
# lights: of each ENABLE line, by the trace: times written on, the last value written, the last one read after it.
lights() {
  local base
  base=$(sed -nE 's/.*GPIOs ([0-9]+)-.*rig-lines.*/\1/p' /sys/kernel/debug/gpio)
  awk -v a=$((base + $(line_of ENABLE0))) -v b=$((base + $(line_of ENABLE1))) '
    {for (i = 1; i < NF; i++) if ($i == "gpio_value:") {n = $(i + 1); how = $(i + 2); v = $(i + 3)
       if (how == "set") {if (v == 1 && last[n] != 1) on[n]++; last[n] = v; read_back[n] = "-"} else read_back[n] = v}}
    END {printf "%d %s %s, %d %s %s", on[a], last[a], read_back[a], on[b], last[b], read_back[b]}' "$tracing/trace"
}
thaw() { [ ! -e /tmp/frozen ] || { rm /tmp/frozen; fsfreeze --unfreeze $disk; }; }
freeze() {
  touch /tmp/frozen
  # Whatever becomes of this script: nothing waits for ever.
  (sleep $((2 * limit_s)); thaw) &
  timer=$!
  fsfreeze --freeze $disk
}

# set_aside BLOCKS: the disk gives no more away; at once, where writing it full takes longer than a capture.
set_aside() { echo "$1" >"/sys/fs/ext4/$(basename "$(df $disk | awk 'END {print $1}')")/reserved_clusters"; }

# The ways to die and to stall; the light must be gone when they return, but for the time it takes to go.
die_of() { kill "-$1" "$pid"; }
stall() {
  case "$1" in
    memory | file | cpu) /build/bin/rig-vm-process limit "$pid" "$1" ;;
    frozen-disk) freeze ;;
    frozen-disk-and-*) freeze; usleep 200000; kill "-${1#frozen-disk-and-}" "$pid" ;;
    frozen-disk-twice-*)
      freeze
      kill "-${1#frozen-disk-twice-}" "$pid"
      soon dark
      kill "-${1#frozen-disk-twice-}" "$pid"
      ;;
    full-disk) set_aside $((disk_mib * 1024 - 1)) ;;
    silent-camera) v4l2-ctl -d "$camera" -c percentage_of_dropped_buffers=100 ;;
    no-camera) v4l2-ctl -d "$camera" -c disconnect=1 ;;
    silent-projectors) kill -STOP "$responder" ;;
    emergency-stop) pull EMERGENCY_STOP up ;;
    pressed-for-a-moment) pull EMERGENCY_STOP up; usleep 20000; pull EMERGENCY_STOP down ;;
    door) pull DOOR up ;;
  esac
}

# death NAME HOW EXITS: EXITS lists the program's allowed ends. A capture that was over before its moment came shows
# nothing: it is taken again, each time at an earlier one.
death() {
  local tries=1 at_ms
  at_ms=$(awk -v seed="$(option seed)" -v name="$1" -v longest="$lit_ms" '
    BEGIN {for (i = 1; i <= length(name); i++) h = (h * 31 + index("abcdefghijklmnopqrstuvwxyz", tolower(substr(name, i, 1)))) % 65521
           srand(seed * 65536 + h); printf "%d", rand() * 0.8 * longest}')
  until death_once "$tries" "$at_ms" "$@"; do
    [ "$late" = 1 ] && [ "$tries" -lt 4 ] || {
      failures=$((failures + 1))
      break
    }
    tries=$((tries + 1)) at_ms=$((at_ms / 4))
  done
  echo "$row" >>$cases
}
# One try; leaves `row`, `late` and `lit_ms`, fails where the verdict does.
death_once() {
  local tries=$1 at_ms=$2 name=$3 how=$4 exits=$5 out verdict="ok     " ended since lit_count store wanted why=""
  out=/share/$(echo "$name" | tr -c 'a-zA-Z0-9\n' -)$tries store=$disk/store late=0 timer=
  mkdir -p "$out"
  load_camera
  mount -o noatime -t ext2 /tmp/disk.img $disk
  rm -rf ${store:?}
  echo >"$tracing/trace"
  /build/bin/rig-vm-responder $plan "$screen" >"$out/responder.log" 2>&1 &
  responder=$!
  soon grep -qs ready "$out/responder.log" || why="no responder"
  chip=/sys/devices/platform/$(cat /sys/kernel/config/gpio-sim/rig-lines/dev_name)/$(cat /sys/kernel/config/gpio-sim/rig-lines/bank0/chip_name)
  # Each frame is a mapping of its own, so that no memory means no frame.
  GLIBC_TUNABLES=glibc.malloc.mmap_threshold=65536 /build/bin/rig-vm-process run /build/bin/stratalux-rig capture \
    --config $plan --store $store --pose 0 --calibration none --json >"$out/outcome.json" 2>"$out/rig.log" &
  pid=$!
  soon lit || why="never lit"
  since=$(now_ms)
  usleep $((at_ms * 1000))
  alive || late=1
  case "$how" in
    none) soon gone; lit_ms=$(($(now_ms) - since)) ;;
    [A-Z]*) die_of "$how" ;;
    *) stall "$how" ;;
  esac
  soon dark || why="${why:+$why; }light stays on"
  lit_count=$(lights)
  [ "$timer" = "" ] || [ -e /tmp/frozen ] || why="${why:+$why; }thawed before it was dark"
  thaw
  soon gone || { why="${why:+$why; }does not end"; kill -KILL "$pid"; }
  wait $pid
  ended=$?
  usleep 1000000
  [ "$(lights | sed 's/ [01-] [01-]//g')" = "$(echo "$lit_count" | sed 's/ [01-] [01-]//g')" ] || why="${why:+$why; }lit up later"
  lit_count=$(lights)
  echo "$lit_count" | grep -qE '^[1-9][0-9]* 0 0, [1-9][0-9]* 0 0$' || why="${why:+$why; }not written off and read back"
  kill -CONT $responder
  # Busy with what it missed it takes no notice of the first one.
  while kill $responder 2>/dev/null; do usleep 100000; done
  wait $responder
  [ "$timer" = "" ] || kill $timer
  set_aside 0
  /build/bin/stratalux-db reindex --store $store >>"$out/rig.log" 2>&1
  session=$(/build/bin/stratalux-db show s000001 --json --store $store 2>>"$out/rig.log" | sed -nE 's/^ *"status": "([a-z]+)".*/\1/p')
  umount $disk || why="${why:+$why; }the disk is held"
  # Exit 1 of itself: it was ending before its moment came.
  case " $exits " in *" $ended "*) ;; *) why="${why:+$why; }exit" late=$((late | (ended == 1))) ;; esac
  wanted=failed
  # The emulator may stall until the capture gives up: nothing to be learnt from.
  [ "$how" != none ] || wanted=complete late=1
  [ "$session" = $wanted ] || why="${why:+$why; }session"
  [ -z "$why" ] || verdict="FAILED "
  row=$(printf '%s %-26s | %6s | %3s | %-8s | %s%s%s' "$verdict" "$name" "$at_ms" "$ended" "${session:-none}" "$lit_count" \
    "${why:+ | $why}" "$([ "$tries" -eq 1 ] || echo " | try $tries")")
  [ -z "$why" ]
}

# name; signal or stall; the program's ends
deaths() {
  sed 's/ *; */;/g' <<'ROWS'
hang-up                      ; HUP                     ; 129
quit                         ; QUIT                    ; 131
broken pipe                  ; PIPE                    ; 141
segmentation fault           ; SEGV                    ; 139
bus error                    ; BUS                     ; 135
abort                        ; ABRT                    ; 134
alarm                        ; ALRM                    ; 142
user signal                  ; USR1                    ; 138
terminated                   ; TERM                    ; 1
interrupted                  ; INT                     ; 1
Ctrl-Z                       ; TSTP                    ; 1
interrupted twice            ; frozen-disk-twice-INT   ; 130
fault beside a frozen disk   ; frozen-disk-and-SEGV    ; 139
frozen disk                  ; frozen-disk             ; 1
full disk                    ; full-disk               ; 1
no memory                    ; memory                  ; 134
file too large               ; file                    ; 153
out of processor time        ; cpu                     ; 152
silent camera                ; silent-camera           ; 1
camera unplugged             ; no-camera               ; 1
silent projectors            ; silent-projectors       ; 1
emergency stop               ; emergency-stop          ; 1
E-STOP pressed for a moment  ; pressed-for-a-moment    ; 1
door                         ; door                    ; 1
ROWS
}

modprobe gpio-sim
modprobe loop
modprobe ext4
mkdir -p $disk $tracing
echo mono >$tracing/trace_clock
echo 16384 >$tracing/buffer_size_kb  # minutes of light, whose guard reads both lines every 5 ms
echo 1 >$tracing/events/gpio/gpio_value/enable
dd if=/dev/zero of=/tmp/disk.img bs=1M count=$disk_mib 2>/dev/null
mke2fs -b 1024 -F /tmp/disk.img >/dev/null
echo "        death | ms after the first light | exit | session | ENABLE lines: times on, last written, last read" >$cases
lit_ms=0
death "none" none 0
deaths | sample "$(option faults)" "$(option seed)" >/tmp/deaths
while IFS=';' read -r name how exits; do death "$name" "$how" "$exits" </dev/null; done </tmp/deaths
finish
