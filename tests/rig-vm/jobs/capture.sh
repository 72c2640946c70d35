#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
. /source/tests/rig-vm/guest-lib.sh
modprobe gpio-sim
modprobe vivid n_devs=1 node_types=0x101 num_inputs=1 input_types=0x3 num_outputs=1 output_types=0x1
v4l2-ctl --list-devices > /share/log 2>&1
for d in /dev/video0 /dev/video1; do v4l2-ctl -d $d --all | head -12 >> /share/log 2>&1; done
v4l2-ctl -d /dev/video0 --set-dv-bt-timings cvt,width=800,height=600,fps=30 >>/share/log 2>&1 
v4l2-ctl -d /dev/video1 --set-dv-bt-timings cvt,width=800,height=600,fps=30 >>/share/log 2>&1 
v4l2-ctl -d /dev/video0 -c loop_video=1,osd_text_mode=2,timestamp_source=1 >>/share/log 2>&1
/build/bin/rig-vm-responder /source/tests/rig-vm/plans/loop.toml /dev/video1 >/share/responder 2>&1 &
r=$!
sleep 3
cat /share/responder >> /share/log
/build/bin/stratalux-rig capture --config /source/tests/rig-vm/plans/loop.toml --store /tmp/store --visitor v-00000001 --consent-scope fit --consent-text 2026-03 --consent-language en --json > /share/outcome.json 2>/share/rig.log
echo "exit $?" >> /share/log
v4l2-ctl -d /dev/video0 --all >> /share/log 2>&1
kill $r; wait $r; echo "responder $?" >> /share/log
finish
