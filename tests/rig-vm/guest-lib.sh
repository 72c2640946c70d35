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
finish() { [ "$failures" -eq 0 ]; exit; }

# start_udev: libcamera learns of devices from it.
start_udev() {
  /lib/systemd/systemd-udevd --daemon
  udevadm trigger --type=subsystems
  udevadm trigger
  udevadm settle -t 20
}
