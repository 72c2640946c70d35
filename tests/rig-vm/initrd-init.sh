#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# First program of the guest: loads what 9p needs, lays a writable layer over the shared root and goes there.
export PATH=/bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
while read -r module; do insmod "/modules/$module"; done </modules/order
mount -t 9p -o ro,trans=virtio,version=9p2000.L,msize=512000,cache=loose root /lower
mount -t tmpfs -o mode=755 tmpfs /upper
mkdir /upper/changes /upper/work
mount -t overlay -o lowerdir=/lower,upperdir=/upper/changes,workdir=/upper/work overlay /root
for folder in proc sys dev; do mount -o move "/$folder" "/root/$folder"; done
mount -t 9p -o ro,trans=virtio,version=9p2000.L,msize=512000,cache=loose source /root/source
exec switch_root /root /source/tests/rig-vm/guest-init.sh
