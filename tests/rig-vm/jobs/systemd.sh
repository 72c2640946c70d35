#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The kiosk as a service of Debian's systemd, by the units, rules and accounts that are shipped, before the loop's scene:
# `rig.faults` of the cases below, drawn by `rig.seed`, each on a fresh store.
#   case | what was seen
export PATH=/bin:/sbin:/usr/bin:/usr/sbin
. /source/tests/rig-vm/guest-lib.sh
disk_mib=288  # as systemd.boot.sh made it
. /source/tests/rig-vm/lights-lib.sh
limit_s=$((180 * $(option patience)))
kiosk=stratalux-kiosk.service
disk=/var/lib/stratalux
store=$disk/store

# ---- What is looked at ----------------------------------------------------------------------------------------------

of_unit() { systemctl show -P "$2" "$1"; }  # UNIT PROPERTY
screen() { of_unit $kiosk StatusText | sed 's/,.*//'; }
shows() { [ "$(screen)" = "$1" ]; }
shows_one_of() { case " $* " in *" $(screen) "*) ;; *) false ;; esac }
main_pid() { of_unit $kiosk MainPID; }
restarted() { [ "$(of_unit $kiosk NRestarts)" -ge "$1" ] && [ "$(of_unit $kiosk ActiveState)" = active ]; }
lit() { enables 2>/dev/null | grep -q 1; }
# page PATH: status and body of what the kiosk's page answers the operator.
page() {
  { printf 'GET %s HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nAuthorization: Bearer the-operator-of-rig-vm\r\nConnection: close\r\n\r\n' "$1"; sleep 5; } | timeout 20 nc 127.0.0.1 8080 | tr -d '\r' | sed -n '1p;/^$/,$p'
}
closed_for() {
  page /readyz >/tmp/readyz
  echo "readyz: $(tr '\n' ' ' </tmp/readyz)"
  grep -q ' 503 ' /tmp/readyz && grep -q "$1" /tmp/readyz
}
ready() { page /readyz | grep -q ' 200 '; }
said() { journalctl -q --no-pager -u $kiosk --since="@$began" -g "$1" >/dev/null; }
# As the account that owns the store.
as_rig() { POSIXLY_CORRECT=1 STATE_DIRECTORY=$disk su -s /bin/sh stratalux -c 'exec "$@"' sh "$@"; }
db() { as_rig /usr/bin/stratalux-db "$@" --store $store --json 2>>"$out/db.log"; }
# There was a visitor, of whom a certificate is left.
forgotten() { [ "$(db ls)" = "[]" ] && [ "$(db deletions | grep -c '"session')" -ge 1 ]; }

# need WHAT COMMAND...: what is not so is the case's verdict; the case goes on.
need() {
  local what="$1"
  shift
  if "$@"; then what="-"; else why="${why:+$why; }$what"; fi
  echo "$(cut -d' ' -f1 /proc/uptime) $(of_unit $kiosk StatusText): $*: $what"  # job.log
}
not() { ! "$@"; }

press_start() {
  pull START up
  usleep 300000
  pull START down
}
# A visitor who is being captured, with light on: the button says that nothing speaks against it, and that the paper is
# signed, too.
begin_capture() {
  local next
  for next in idle question consent; do
    need "never $next" soon shows $next
    press_start
  done
  need "no capture" soon shows_one_of capture thanks gate
  need "never lit" soon lit
}
# The kiosk on an empty disk, waiting for visitors.
fresh_disk() {
  systemctl stop $kiosk
  set_aside 0
  rm -rf ${disk:?}/*
  systemd-tmpfiles --create /usr/lib/tmpfiles.d/stratalux.conf
}
fresh_kiosk() {
  fresh_disk
  echo >$tracing/trace
  began=$(date +%s)
  need "does not start" systemctl start $kiosk
  need "does not come to idle" soon shows idle
}
store_is_whole() { as_rig /usr/bin/stratalux-db verify --deep --store $store >>"$out/verify.log" 2>&1; }

# ---- The cases ------------------------------------------------------------------------------------------------------

# opens DEVICE: whether a program in the kiosk's cgroup may, root that passes by all rights of files included.
opens() { sh -c 'echo $$ >/sys/fs/cgroup/system.slice/stratalux-kiosk.service/cgroup.procs && exec 3<>"$1"' sh "$1" 2>/dev/null; }
starts() {
  need "safe at boot: $(of_unit stratalux-safe.service Result)" [ "$(of_unit stratalux-safe.service ExecMainExitTimestampMonotonic)" -gt 0 ]
  need "safe at boot ended with $(of_unit stratalux-safe.service ExecMainStatus)" [ "$(of_unit stratalux-safe.service ExecMainStatus)" = 0 ]
  need "lights at boot: $boot_lights" [ "$boot_lights" = "1 0 0, 1 0 0" ]
  fresh_kiosk
  need "not ready by its own word" [ "$(of_unit $kiosk ActiveState)/$(of_unit $kiosk Type)" = active/notify ]
  need "runs as $(stat -c %U "/proc/$(main_pid)")" [ "$(stat -c %U "/proc/$(main_pid)")" = stratalux ]
  # Its own devices, under names that stay, and nobody else's.
  need "rights of lines" [ "$(stat -Lc '%U:%G %a' /dev/stratalux/lines)" = "root:stratalux 660" ]
  need "rights of the camera" [ "$(stat -Lc '%U:%G %a' /dev/stratalux/camera)" = "root:stratalux 660" ]
  need "lines are another chip" [ "$(readlink -f /dev/stratalux/lines)" = "/dev/$(basename "$chip")" ]
  need "the camera is another device" [ "$(readlink -f /dev/stratalux/camera)" = "$(v4l2_node vid-cap)" ]
  make_lines other-chip LAMP
  udevadm settle -t 60
  other=/dev/$(cat /sys/kernel/config/gpio-sim/other-chip/bank0/chip_name)
  as_rig /usr/bin/stratalux-rig devices --json >"$out/devices.json" 2>"$out/devices.log"
  values_of "$out/devices.json" >"$out/devices"
  need "its lines are refused" grep -qx "chips..label rig-lines" "$out/devices"
  need "its camera is refused" grep -qx "v4l2..path $(v4l2_node vid-cap)" "$out/devices"
  need "others' lines are open to it" grep -qx "refused..path $other" "$out/devices"
  need "others' video nodes are open to it" grep -qx "refused..path $(v4l2_node vid-out)" "$out/devices"
  for device in /dev/stratalux/lines /dev/stratalux/camera /dev/null; do need "$device is closed to the unit" opens $device; done
  for device in /dev/loop0 /dev/kmsg /dev/mem /dev/ttyS0; do
    need "$device cannot be opened at all" test -c $device -o -b $device
    need "$device is open to the unit" not opens $device
  done
  remove_lines other-chip
}

# After the kiosk's death in a capture: dark, nothing of the visit kept, waiting for the next.
starts_anew() {
  need "light stays on" soon dark
  # Safe ones write and read, and so does the kiosk that starts again: between the two the last write is not read yet.
  need "not written off and read back: $(lights)" soon went_dark
  need "not started again" soon restarted 1
  need "does not come to idle again" soon shows idle
  need "the unfinished visit is kept" forgotten
  need "the store is not whole" store_is_whole
}

dies() {
  fresh_kiosk
  begin_capture
  kill -KILL "$(main_pid)"
  starts_anew
}

hangs() {
  fresh_kiosk
  begin_capture
  kill -STOP "$(main_pid)"
  need "no watchdog" soon said "Watchdog timeout"
  starts_anew
}

# Nobody but their timers begins them.
skipped() { [ "$(of_unit "$1" Result)" = exec-condition ]; }
ran() { [ "$(of_unit "$1" ExecMainExitTimestampMonotonic)" -gt 0 ] && [ "$(of_unit "$1" ActiveState)" = inactive ]; }
timers() {
  fresh_kiosk
  systemctl start stratalux-purge.timer stratalux-verify.timer
  need "not armed" systemctl -q is-active stratalux-purge.timer stratalux-verify.timer
  # A week on both are due. Without a store there is nothing to do, and that is no fault.
  date -s "@$(($(date +%s) + 8 * 86400))" >/dev/null
  for unit in purge verify; do need "$unit without a store is not skipped" soon skipped stratalux-$unit.service; done
  as_rig /usr/bin/stratalux-db init --store $store
  date -s "@$(($(date +%s) + 8 * 86400))" >/dev/null
  for unit in purge verify; do
    need "$unit was not run" soon ran stratalux-$unit.service
    need "$unit ended with $(of_unit stratalux-$unit.service ExecMainStatus)" [ "$(of_unit stratalux-$unit.service Result)/$(of_unit stratalux-$unit.service ExecMainStatus)" = success/0 ]
  done
  systemctl stop stratalux-purge.timer stratalux-verify.timer
  need "the kiosk was disturbed" restarted 0
}

# The camera comes back, under another number, and a visit is captured by the same program.
comes_back() {
  echo vivid.0 >/sys/bus/platform/drivers/vivid/bind
  set_camera
  udevadm settle -t 60
  kill -HUP "$(cat /run/rig/responder.pid)"
  need "does not come back" soon shows idle
  begin_capture
  need "the visit is not kept" soon of_kept 1
  need "was started anew" [ "$(main_pid)" = "$before" ]
}
unplugged() {
  fresh_kiosk
  before=$(main_pid)
  echo vivid.0 >/sys/bus/platform/drivers/vivid/unbind
  need "not closed" soon shows closed
  need "closed for something else" soon closed_for device
  comes_back
  need "the store is not whole" store_is_whole
}
# What is away when the program starts comes later: nobody stands before a black screen.
starts_without_a_camera() {
  fresh_disk
  echo vivid.0 >/sys/bus/platform/drivers/vivid/unbind
  began=$(date +%s)
  need "does not start" systemctl start $kiosk
  before=$(main_pid)
  need "not closed" soon shows closed
  need "closed for something else" soon closed_for device
  comes_back
}
of_kept() { of_unit $kiosk StatusText | grep -q ", $1 visits kept"; }

clock_jumps() {
  fresh_kiosk
  before=$(main_pid)
  begin_capture
  date -s "@$(($(date +%s) + 40 * 86400))" >/dev/null
  need "forwards: the visit is not kept" soon of_kept 1
  need "forwards: not said" soon said clock
  need "forwards: does not come to idle" soon shows idle
  began=$(($(date +%s) - 80 * 86400))
  date -s "@$began" >/dev/null
  need "backwards: not said" soon said clock
  begin_capture
  need "backwards: the visit is not kept" soon of_kept 2
  need "backwards: does not come to idle" soon shows idle
  need "was started anew" [ "$(main_pid)" = "$before" ]
  need "the store is not whole" store_is_whole
}

full_disk() {
  fresh_kiosk
  before=$(main_pid)
  set_aside $((disk_mib * 1024 - 1))
  need "not closed" soon shows closed
  need "closed for something else" soon closed_for space
  set_aside 0
  need "does not open again" soon shows idle
  need "not ready" soon ready
  need "was started anew" [ "$(main_pid)" = "$before" ]
}

# batch_is TEXT: what the operator's screen says of the next batch begins so. The kiosk asks once a minute.
batch_is() {
  page /operator/status >/tmp/status
  sed -n 's/.*"batch":\({[^{}]*\).*/batch: \1/p' /tmp/status
  grep -qF "\"batch\":{$1" /tmp/status
}
# The evening of the timer's, now or tomorrow, in seconds.
next_evening() { echo $((($(date +%s) - 72000 + 86399) / 86400 * 86400 + 72000)); }
batch=stratalux-batch
# By the hardened unit's account, over D-Bus.
next_batch() {
  # The emulator's first systemctl of an account took 8 s, the next ones 2 s: the kiosk gives it 3.
  as_rig /bin/systemctl show $batch.timer >/dev/null
  fresh_kiosk
  before=$(main_pid)
  need "a timer that is off is not said to be" soon batch_is '"timer":"off","next":null'
  systemctl start $batch.timer
  evening=$(next_evening)
  need "not named" soon batch_is "\"timer\":\"on\",\"next\":$evening,\"last\":null"
  # A bus that stands still: no answer is said, and nobody waits for it, the watchdog least of all.
  bus=$(of_unit dbus.service MainPID)
  kill -STOP "$bus"
  need "an answer without a bus" soon batch_is '"timer":"unknown"'
  kill -CONT "$bus"
  need "not named again" soon batch_is "\"timer\":\"on\",\"next\":$evening"
  need "somebody was left waiting" soon not pidof systemctl
  # It goes off; there is nothing to fit.
  date -s "@$evening" >/dev/null
  need "was not begun" soon skipped $batch.service
  need "the next evening is not named" soon batch_is "\"timer\":\"on\",\"next\":$((evening + 86400)),\"last\":$((evening / 1000))"
  systemctl stop $batch.timer
  need "was started anew" [ "$(main_pid)" = "$before" ]
}

# An encrypted visitor whose keys stayed on its rig, fitted in the batch's own sandbox by its credential: the quickest fit
# that goes the whole road. Without the credential nobody is fitted.
is_over() { ran "$1" || [ "$(of_unit "$1" ActiveState)" = failed ]; }
night_of_fits() {
  cp /share/libraries/* /usr/lib/x86_64-linux-gnu/
  systemctl stop $kiosk
  set_aside 0
  rm -rf ${disk:?}/*
  systemd-tmpfiles --create /usr/lib/tmpfiles.d/stratalux.conf
  # A mono camera sees a quad with each of its pixels: a surface as fine as that of a mosaic twice as wide.
  printf 'name = "face"\n[subject]\nshape = "head"\n[camera]\ncfa = "mono"\n' >/run/rig/face.toml
  { printf '[camera]\nwidth = 174\nheight = 130\n'; cat /source/tests/support/smallest_plan.toml; } >/run/rig/small.toml
  chmod 755 /run/rig
  credentials=/etc/credstore
  as_rig /usr/bin/stratalux-rig capture --simulate=/run/rig/face.toml --no-scattering --seed 3 --config /run/rig/small.toml \
    --encrypt --store $store >"$out/capture.log" 2>&1
  /usr/bin/stratalux-db key reader-init --out /run/rig/reader.key >/run/rig/reader.pub 2>>"$out/db.log"
  chmod 644 /run/rig/reader.pub
  as_rig /usr/bin/stratalux-db key share /run/rig/reader.pub --store $store >>"$out/db.log" 2>&1
  rm $store/keys.sqlite  # as a pull leaves it, for which the guest has no rsync
  need "no visitor" [ "$(db ls | grep -c '"complete"')" = 1 ]
  # An operator's options; all else is the unit's.
  mkdir -p /run/systemd/system/$batch.service.d
  printf '[Service]\nExecStart=\nExecStart=%s --pool 2 --prior none --offset off --maps off --iterations 1 --layers 1\n' \
    "$(sed -n 's/^ExecStart=//p' /usr/lib/systemd/system/$batch.service)" >/run/systemd/system/$batch.service.d/options.conf
  systemctl daemon-reload
  systemctl start $batch.service
  need "fitted without the credential" [ "$(fits)" = 0 ]
  as_rig /usr/bin/stratalux-fit batch report --text --store $store >"$out/blind.txt" 2>&1
  need "who is left out is not named" grep -q "no reader's key was given" "$out/blind.txt"
  mkdir -m 700 -p $credentials
  mv /run/rig/reader.key $credentials/reader.key
  systemctl reset-failed $batch.service 2>/dev/null
  systemctl start $batch.timer
  date -s "@$(next_evening)" >/dev/null
  need "the timer does not begin it" soon begun
  looked=$(sandbox_of "$(of_unit $batch.service MainPID)")
  need "its sandbox: $looked" [ "$looked" = "stratalux, alone with lo, no rights, filtered, no disk" ]
  night_s=$((3 * limit_s))
  need "not over" soon_within $night_s is_over $batch.service
  need "ended with $(of_unit $batch.service Result)/$(of_unit $batch.service ExecMainStatus)" \
    [ "$(of_unit $batch.service Result)/$(of_unit $batch.service ExecMainStatus)" = success/0 ]
  systemctl stop $batch.timer
  db show latest >"$out/show.json"
  cp -r $store/nights "$out/" 2>/dev/null
  need "no fit in the store" [ "$(fits)" = 1 ]
  need "its layers are plain" [ "$(head -c 7 $store/sessions/*/fits/*/layers_weight.exr)" = SLXSEAL ]
  need "a key stays" [ ! -e $store/keys.sqlite ]
  need "the store is not whole" store_is_whole
  rm -r $credentials
}
fits() { ls $store/sessions/*/fits 2>/dev/null | wc -l; }
# Not what systemd still is before it becomes the program.
begun() { [ "$(readlink "/proc/$(of_unit $batch.service MainPID)/exe")" = /usr/bin/stratalux-fit ]; }
# sandbox_of PID: what the kernel says of the process.
sandbox_of() {
  local at=/proc/$1
  [ "$(readlink "$at/ns/net")" != "$(readlink /proc/1/ns/net)" ] || printf 'in the network of all, '
  printf '%s, alone with %s, ' "$(stat -c %U "$at")" "$(awk -F: 'NR > 2 {gsub(/ /, "", $1); print $1}' "$at/net/dev" | tr '\n' ' ' | sed 's/ $//')"
  grep -q '^CapBnd:.*[1-9a-f]' "$at/status" && printf 'rights, ' || printf 'no rights, '
  grep -q '^Seccomp:[[:space:]]*2' "$at/status" && printf 'filtered, ' || printf 'unfiltered, '
  if [ -e "$at/root/dev/loop0" ]; then printf 'disks'; else printf 'no disk'; fi
}

# case NAME FUNCTION
case_of() {
  why="" out=/share/$(echo "$1" | tr -c 'a-zA-Z0-9\n' -)
  mkdir -p "$out"
  "$2"
  journalctl -q --no-pager >"$out/journal.log"
  journalctl -q --no-pager --rotate --vacuum-time=1s >/dev/null 2>&1
  if [ -z "$why" ]; then
    printf 'ok      %-24s | %s\n' "$1" "$(lights)" >>$cases
  else
    printf 'FAILED  %-24s | %s | %s\n' "$1" "$(lights)" "$why" >>$cases
    failures=$((failures + 1))
  fi
}
rows() {
  cat <<'ROWS'
starts;starts
killed mid-capture;dies
hangs mid-capture;hangs
timers;timers
camera unplugged and back;unplugged
clock jumps;clock_jumps
full disk and freed;full_disk
ROWS
}
# Minutes of an emulator's time: at night, or asked for by name.
rows_of_the_night() {
  cat <<'ROWS'
no camera at start;starts_without_a_camera
next batch;next_batch
a night of fits;night_of_fits
ROWS
}

find_chip
boot_lights=$(lights)
echo "        case | ENABLE lines: times on, last written, last read" >$cases
if [ -s /share/case ]; then
  { rows; rows_of_the_night; } | grep "^$(cat /share/case);" >/tmp/rows || judge "there is no case '$(cat /share/case)'" false
else
  rows | sample "$(option faults)" "$(option seed)" >/tmp/rows
  [ "$(option faults)" -lt "$(rows | wc -l)" ] || rows_of_the_night >>/tmp/rows
fi
while IFS=';' read -r name how; do case_of "$name" "$how" </dev/null; done </tmp/rows
systemctl stop $kiosk
finish
