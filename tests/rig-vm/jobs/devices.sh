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
crc=$(dirname "$(grep -l vkms /sys/kernel/debug/dri/*/name)")/crtc-0/crc
export STRATALUX_TEST_CRC="$crc"
run_tests firmware_host_projector_tests 'KmsDisplay.*'

start_udev
modprobe vimc
udevadm settle -t 20
export LIBCAMERA_LOG_LEVELS="*:ERROR"
export STRATALUX_TEST_LIBCAMERA="platform/vimc.0 Sensor B"
export STRATALUX_TEST_LIBCAMERA_UNBIND="/sys/bus/platform/drivers/vimc/unbind vimc.0"
run_tests firmware_host_libcamera_tests 'LibcameraCamera.*'
finish
