#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# First program on the guest's root: mounts what programs expect, runs the job named on the kernel's command line,
# leaves its exit status in /share/status and switches off. A job with a file JOB.boot.sh is run by that one's ways.
export PATH=/bin:/sbin:/usr/bin:/usr/sbin
mount -t tmpfs tmpfs /run
mount -t tmpfs tmpfs /tmp
mkdir -p /dev/shm /dev/pts
mount -t tmpfs tmpfs /dev/shm
mount -t devpts devpts /dev/pts
ln -s /proc/self/fd /dev/fd
mount -t 9p -o ro,trans=virtio,version=9p2000.L,msize=512000,cache=loose build /build
mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000 share /share
modprobe configfs
mount -t configfs configfs /sys/kernel/config
mount -t debugfs debugfs /sys/kernel/debug
mount -t tracefs tracefs /sys/kernel/tracing
ip link set lo up
job=$(sed -E 's/.*rig\.job=([a-z0-9-]+).*/\1/' /proc/cmdline)
[ ! -e "/source/tests/rig-vm/jobs/$job.boot.sh" ] || exec sh "/source/tests/rig-vm/jobs/$job.boot.sh" "$job"
exec sh /source/tests/rig-vm/run-job.sh "$job"
