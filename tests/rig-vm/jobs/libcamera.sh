#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The libcamera source on vimc, Debian's own libcamera between them.
. /source/tests/rig-vm/guest-lib.sh

start_udev
modprobe vimc
udevadm settle -t 20
export LIBCAMERA_LOG_LEVELS="*:ERROR"
export STRATALUX_TEST_LIBCAMERA="platform/vimc.0 Sensor B"
export STRATALUX_TEST_LIBCAMERA_UNBIND="/sys/bus/platform/drivers/vimc/unbind vimc.0"
run_tests firmware_host_libcamera_tests 'LibcameraCamera.*'
finish
