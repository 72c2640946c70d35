#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Displays on vkms: paced flips, the pattern that leaves the connector, what goes wrong.
. /source/tests/rig-vm/guest-lib.sh

modprobe vkms
export STRATALUX_TEST_DISPLAY=Virtual-1
crc=$(dirname "$(grep -l vkms /sys/kernel/debug/dri/*/name)")/crtc-0/crc
export STRATALUX_TEST_CRC="$crc"
run_tests firmware_host_projector_tests 'KmsDisplay.*'
finish
