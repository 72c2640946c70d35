#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The simulated devices are there and answer: lines, camera, display.
. /source/tests/rig-vm/guest-lib.sh

lines_work() {
  modprobe gpio-sim || return 1
  make_lines rig-lines P0_TRIGGER P0_SYNC P0_ENABLE || return 1
  gpioset --mode=time --sec=2 "$(gpiofind P0_TRIGGER | cut -d' ' -f1)" 0=1 &
  sleep 1
  [ "$(cat "$lines/sim_gpio0/value")" = 1 ] || return 1
  wait
  echo pull-up >"$lines/sim_gpio1/pull"
  [ "$(gpioget "$(gpiofind P0_SYNC | cut -d' ' -f1)" 1)" = 1 ]
}
camera_works() {
  modprobe vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0x0 || return 1
  v4l2-ctl -d /dev/video0 -v width=320,height=180,pixelformat='Y12 ' --stream-mmap=4 --stream-count=10 --stream-to=/tmp/frames
  [ "$(stat -c %s /tmp/frames)" -eq $((10 * 320 * 180 * 2)) ]
}
display_works() { modprobe vkms && grep -qx connected /sys/class/drm/*-Virtual-1/status; }

check "lines (gpio-sim)" lines_work
check "camera (vivid)" camera_works
check "display (vkms)" display_works
check "libcamera's camera (vimc)" modprobe vimc
finish
