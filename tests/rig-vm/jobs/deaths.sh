#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# `stratalux-rig capture` on the kernel's interfaces dies, is stopped or stalls, at a moment drawn by `rig.seed`:
# `rig.faults` of the ways below. Each time the kernel's trace must tell of every ENABLE line that its last write was
# off, by the program, and read back since; nothing lights up later, and the store opens with the session failed.
#   death | ms after the first light | exit | session | lights: times on, last write, last reading
. /source/tests/rig-vm/guest-lib.sh
. /source/tests/rig-vm/lights-lib.sh

plan=/tmp/short.toml  # references, codes and guards
sed 's/^kind = "visitor"/kind = "calibration"/' /source/tests/rig-vm/plans/loop.toml >$plan
export STATE_DIRECTORY=/tmp/state
mkdir -p "$STATE_DIRECTORY"
disk=/tmp/disk  # a file system of its own
limit_s=$((180 * $(option patience)))

alive() { kill -0 "$pid" 2>/dev/null; }
lit() { ! alive || enables | grep -q 1; }
gone() { ! alive; }
thaw() { [ ! -e /tmp/frozen ] || { rm /tmp/frozen; fsfreeze --unfreeze $disk; }; }
freeze() {
  touch /tmp/frozen
  # Whatever becomes of this script: nothing waits for ever.
  (sleep $((2 * limit_s)); thaw) &
  timer=$!
  fsfreeze --freeze $disk
}

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
  find_chip
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
  went_dark || why="${why:+$why; }not written off and read back"
  kill -CONT $responder
  # Busy with what it missed it takes no notice of the first one.
  while kill $responder 2>/dev/null; do usleep 100000; done
  wait $responder
  [ "$timer" = "" ] || kill $timer
  set_aside 0
  /build/bin/stratalux-db reindex --store $store >>"$out/rig.log" 2>&1
  session=$(/build/bin/stratalux-db show s000001 --json --store $store 2>>"$out/rig.log" | sed -nE 's/^ *"status": "([a-z]+)".*/\1/p')
  umount $disk || why="${why:+$why; }the disk is held"
  # Exit 0, 1 or 3 of itself: it was ending before its moment came.
  case " $exits " in *" $ended "*) ;; *) why="${why:+$why; }exit" late=$((late | (ended == 0 || ended == 1 || ended == 3))) ;; esac
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
mkdir -p $disk
trace_lights
make_disk /tmp/disk.img
echo "        death | ms after the first light | exit | session | ENABLE lines: times on, last written, last read" >$cases
lit_ms=0
death "none" none 0
deaths | sample "$(option faults)" "$(option seed)" >/tmp/deaths
while IFS=';' read -r name how exits; do death "$name" "$how" "$exits" </dev/null; done </tmp/deaths
finish
