# SPDX-License-Identifier: Apache-2.0
# What the jobs share; sourced by them in the guest.
failures=0
cases=/share/cases

# check NAME COMMAND...: one case, one line; what the command says is kept when it fails.
check() {
  local name="$1"
  shift
  if "$@" >/tmp/case.log 2>&1; then
    printf 'ok      %s\n' "$name" >>$cases
  else
    printf 'FAILED  %s (exit %s)\n' "$name" "$?" >>$cases
    sed 's/^/        /' /tmp/case.log | tail -n 40 >>$cases
    failures=$((failures + 1))
  fi
}
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
finish() { [ "$failures" -eq 0 ]; exit; }

# start_udev: libcamera learns of devices from it.
start_udev() {
  /lib/systemd/systemd-udevd --daemon
  udevadm trigger --type=subsystems
  udevadm trigger
  udevadm settle -t 20
}

# make_lines CHIP NAME...: a gpio-sim chip with these lines. Sets `lines` to its sysfs folder: sim_gpioN/{pull,value}.
make_lines() {
  local chip=/sys/kernel/config/gpio-sim/$1
  mkdir -p "$chip/bank0"
  echo "$1" >"$chip/bank0/label"
  shift
  echo $# >"$chip/bank0/num_lines"
  local line=0 name
  for name in "$@"; do
    mkdir "$chip/bank0/line$line"
    echo "$name" >"$chip/bank0/line$line/name"
    line=$((line + 1))
  done
  echo 1 >"$chip/live"
  lines=/sys/devices/platform/$(cat "$chip/dev_name")/$(cat "$chip/bank0/chip_name")
}
