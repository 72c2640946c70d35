# SPDX-License-Identifier: Apache-2.0
# The rig's lines from outside: what is put on them, whether light is on, and what the kernel's trace tells of it; a disk
# that gives nothing more away. Sourced by jobs behind guest-lib.sh. They set `limit_s`, of each wait: a busy machine's
# emulator takes minutes.
tracing=/sys/kernel/tracing/instances/lights  # the responder takes what it reads from the first one
: "${disk_mib:=96}"  # of it

# find_chip: sets `chip`, once the responder has made it.
find_chip() {
  local made=/sys/kernel/config/gpio-sim/rig-lines
  chip=/sys/devices/platform/$(cat $made/dev_name)/$(cat $made/bank0/chip_name)
}
line_of() { basename "$(dirname "$(grep -lx "$1" /sys/kernel/config/gpio-sim/rig-lines/bank0/line*/name)")" | tr -cd 0-9; }
pull() {  # LINE up|down: what the world outside puts on it
  echo "pull-$2" >"$chip/sim_gpio$(line_of "$1")/pull"
}
enables() { cat "$chip/sim_gpio$(line_of ENABLE0)/value" "$chip/sim_gpio$(line_of ENABLE1)/value"; }
# Between two projectors it is dark for a moment; here nothing may come for three seconds.
dark() {
  local i
  for i in 1 2 3 4 5 6; do
    ! enables | grep -q 1 || return 1
    usleep 500000
  done
}

now_ms() { awk '{printf "%d", $1 * 1000}' /proc/uptime; }
# soon COMMAND...: until it succeeds; fails after the limit. soon_within SECONDS COMMAND...: after those.
soon() { soon_within "$limit_s" "$@"; }
soon_within() {
  local end=$(($(now_ms) + $1 * 1000))
  shift
  until "$@"; do
    [ "$(now_ms)" -lt "$end" ] || return 1
    usleep 50000
  done
}

trace_lights() {
  mkdir -p $tracing
  echo mono >$tracing/trace_clock
  echo 16384 >$tracing/buffer_size_kb  # minutes of light, whose guard reads both lines every 5 ms
  echo 1 >$tracing/events/gpio/gpio_value/enable
}
# first_line: the number by which the trace calls the chip's first line. Debugfs has it, until it knows chips and offsets alone.
first_line() {
  local label
  for label in /sys/class/gpio/gpiochip*/label; do
    if grep -qsx rig-lines "$label"; then cat "${label%label}base"; return; fi
  done
  sed -nE 's/.*GPIOs ([0-9]+)-.*rig-lines.*/\1/p' /sys/kernel/debug/gpio
}
# lights: of each ENABLE line, by the trace: times written on, the last value written, the last one read after it.
lights() {
  local base
  base=$(first_line)
  [ -n "$base" ] || { echo "this kernel does not say which lines are the rig's"; return; }
  awk -v a=$((base + $(line_of ENABLE0))) -v b=$((base + $(line_of ENABLE1))) '
    {for (i = 1; i < NF; i++) if ($i == "gpio_value:") {n = $(i + 1); how = $(i + 2); v = $(i + 3)
       if (how == "set") {if (v == 1 && last[n] != 1) on[n]++; last[n] = v; read_back[n] = "-"} else read_back[n] = v}}
    END {printf "%d %s %s, %d %s %s", on[a], last[a], read_back[a], on[b], last[b], read_back[b]}' "$tracing/trace"
}
# Each was on, its last write was off, and it was read back since.
went_dark() { lights | grep -qE '^[1-9][0-9]* 0 0, [1-9][0-9]* 0 0$'; }

# make_disk FILE: an empty file system of its own; the share and the root never stand still.
make_disk() {
  dd if=/dev/zero of="$1" bs=1M count=$disk_mib 2>/dev/null
  mke2fs -b 1024 -F "$1" >/dev/null
}
# set_aside BLOCKS: the disk gives no more away; at once, where writing it full takes longer than a capture.
set_aside() { echo "$1" >"/sys/fs/ext4/$(basename "$(df "$disk" | awk 'END {print $1}')")/reserved_clusters"; }
