#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Every back-end against the kernel's simulated device, with the tests that skip themselves on other machines.
. /source/tests/rig-vm/guest-lib.sh

modprobe gpio-sim
run_tests firmware_host_gpio_tests 'GpiodLineBankTest.*'

modprobe vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0x0
run_tests firmware_host_camera_tests 'V4l2FrameSourceTest.*'
modprobe -r vivid

modprobe vkms
export STRATALUX_TEST_DISPLAY=Virtual-1
crc=$(dirname "$(grep -l vkms /sys/kernel/debug/dri/*/name | head -n 1)")/crtc-0/crc
export STRATALUX_TEST_CRC="$crc"
run_tests firmware_host_projector_tests 'KmsDisplay.*'

start_udev
modprobe vimc
udevadm settle -t 20
export LIBCAMERA_LOG_LEVELS="*:ERROR"
export STRATALUX_TEST_LIBCAMERA="platform/vimc.0 Sensor B"
export STRATALUX_TEST_LIBCAMERA_UNBIND="/sys/bus/platform/drivers/vimc/unbind vimc.0"
run_tests firmware_host_libcamera_tests 'LibcameraCamera.*'

# What the list says of devices that are here, of lines in use, and of the same devices when they are gone.
list() {
  LIBCAMERA_LOG_LEVELS='*:FATAL' /build/bin/stratalux-rig devices --json >"/share/list-$1.json" 2>"/share/list-$1.log" || return 1
  values_of "/share/list-$1.json" >"/share/list-$1"
}
says() { grep -qxF "$2" "/share/list-$1"; }
# One in which the first line is followed by the second, within so many lines.
says_near() { grep -xF -A "$4" "$2" "/share/list-$1" | grep -qxF "$3"; }
never_says() { ! grep -qF "$2" "/share/list-$1"; }
modprobe vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0x0
make_lines judged-chip LAMP BUTTON
modprobe -r vimc  # the tests unplugged it
modprobe vimc
udevadm settle -t 20
hold_lines judged-chip 0=1
holder=$!
for _ in 1 2 3 4 5 6 7 8 9 10; do gpioinfo | grep -q gpioset || usleep 200000; done
judge "devices: the list is made" list here
judge "devices: the camera and its format" says_near here "v4l2..card vivid" "v4l2..formats..name Y12" 400
judge "devices: the camera's driver" says here "v4l2..driver vivid"
judge "devices: the camera behind libcamera" says here "libcamera..id platform/vimc.0 Sensor B"
judge "devices: the chip" says here "chips..label judged-chip"
judge "devices: its lines, one of them in use" says_near here "chips..lines..name LAMP" "chips..lines..consumer gpioset" 4
judge "devices: its other line" says here "chips..lines..name BUTTON"
judge "devices: the display's card" says here "cards..driver vkms"
judge "devices: the display" says_near here "cards..connectors..name Virtual-1" "cards..connectors..connected true" 1
judge "devices: the display's modes" says_near here "cards..connectors..modes..width 640" "cards..connectors..modes..height 480" 1
judge "devices: nobody holds the display" says_near here "cards..driver vkms" "cards..mastered false" 1
kill $holder
wait $holder
remove_lines judged-chip
modprobe -r vivid
echo vimc.0 >/sys/bus/platform/drivers/vimc/unbind
modprobe -r vkms
udevadm settle -t 20
judge "unplugged: the list is made" list gone
judge "unplugged: no camera of vivid" never_says gone vivid
judge "unplugged: no camera behind libcamera" never_says gone "libcamera..id platform/vimc.0"
judge "unplugged: no chip, no line" never_says gone "judged-chip"
judge "unplugged: no display" never_says gone vkms
finish
