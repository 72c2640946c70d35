#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The world outside the computer of the job `systemd`, up before any unit of ours: projectors, scene, and lights that
# were left on by whatever ran before.
export PATH=/bin:/sbin:/usr/bin:/usr/sbin
. /source/tests/rig-vm/guest-lib.sh
. /source/tests/rig-vm/lights-lib.sh
limit_s=$((120 * $(option patience)))
load_camera
udevadm settle -t 60
trace_lights
/build/bin/rig-vm-responder /etc/stratalux/rig.toml /dev/world/screen >/run/rig/responder.log 2>&1 &
echo $! >/run/rig/responder.pid
soon grep -qs ready /run/rig/responder.log || exit 1
udevadm settle -t 60
leave_lines rig-lines "$(line_of ENABLE0)=1" "$(line_of ENABLE1)=1"
