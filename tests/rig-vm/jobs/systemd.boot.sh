#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The boot of the job `systemd`: does what the packages' installation does and what is the machine's own, then Debian's
# systemd goes on as the first program. The job is a service of its own.
root=/source/tests/rig-vm
cp -r /share/installed/usr /share/installed/etc /
mkdir -p /etc/udev/rules.d /run/rig /var/lib/stratalux /var/log /root /home
echo rig-vm >/etc/hostname
echo 0123456789abcdef0123456789abcdef >/etc/machine-id
systemd-sysusers

# The operator's: which devices are the rig's, and its configuration.
cat >/etc/udev/rules.d/59-stratalux-rig.rules <<'RULES'
SUBSYSTEM=="gpio", KERNELS=="gpio-sim.0", ENV{STRATALUX}="lines"
SUBSYSTEM=="video4linux", ATTR{name}=="*-vid-cap", ENV{STRATALUX}="camera"
SUBSYSTEM=="video4linux", ATTR{name}=="*-vid-out", SYMLINK+="world/screen"
RULES
sed -e 's|^driver = .*|device = "/dev/stratalux/camera"|' -e 's|^door = .*|&\nstart = { line = "START" }|' \
    -e 's|^\[capture\]|&\ncalibration = "none"\nmax_visit_s = 120.0|' -e 's|^deadline_ms = [0-9.]*|deadline_ms = 8000.0|' $root/plans/loop.toml |
  cat - $root/plans/kiosk.toml >/etc/stratalux/rig.toml
echo the-operator-of-rig-vm >/etc/stratalux/operator.token
chown stratalux: /etc/stratalux/operator.token
chmod 600 /etc/stratalux/operator.token

# What Debian's own units need on a machine that others use, too.
mkdir -p /etc/systemd/system.conf.d
printf '[Manager]\nDefaultTimeoutStartSec=15min\nDefaultTimeoutStopSec=15min\n' >/etc/systemd/system.conf.d/busy.conf

# The store's disk; what cannot be shipped units' affair in this guest: it has no other disks, consoles, users, clocks.
modprobe loop
modprobe ext4
modprobe gpio-sim
. $root/guest-lib.sh
disk_mib=288  # several visits, and room for the attempts of another
. $root/lights-lib.sh
make_disk /run/rig/disk.img
mount -o noatime -t ext2 /run/rig/disk.img /var/lib/stratalux
for unit in cryptsetup.target dev-hugepages.mount dev-mqueue.mount getty.target hwclock.service integritysetup.target \
    kmod-static-nodes.service proc-sys-fs-binfmt_misc.automount rc-local.service remote-fs.target sys-fs-fuse-connections.mount \
    systemd-ask-password-console.path systemd-ask-password-wall.path systemd-binfmt.service systemd-firstboot.service \
    systemd-hwdb-update.service systemd-initctl.socket systemd-journal-flush.service systemd-journald-audit.socket \
    systemd-logind.service systemd-machine-id-commit.service systemd-modules-load.service systemd-pcrphase-sysinit.service \
    systemd-pcrphase.service systemd-random-seed.service systemd-repart.service systemd-sysctl.service \
    systemd-sysusers.service systemd-tmpfiles-clean.timer systemd-update-utmp.service systemd-user-sessions.service \
    veritysetup.target; do
  ln -sf /dev/null "/etc/systemd/system/$unit"
done

# A random delay of up to 20 minutes is added anew whenever the clock is set, and counts from the boot.
for timer in stratalux-batch stratalux-purge stratalux-verify; do
  mkdir -p /etc/systemd/system/$timer.timer.d
  printf '[Timer]\nRandomizedDelaySec=0\nAccuracySec=1s\n' >/etc/systemd/system/$timer.timer.d/at-once.conf
done

# udev names devices and gives rights; the guest's other devices need no drivers.
for rules in 60-persistent-storage 60-sensor 64-btrfs 75-net-description 80-drivers 80-net-setup-link; do
  ln -s /dev/null /etc/udev/rules.d/$rules.rules
done

# The world outside the computer, and the job: behind everything that a boot starts.
cat >/etc/systemd/system/rig-world.service <<UNIT
[Unit]
Description=What the rig's lines and camera see
After=systemd-udev-trigger.service
Before=stratalux-safe.service
[Service]
Type=oneshot
RemainAfterExit=yes
ExecStart=/bin/sh $root/jobs/systemd.world.sh
UNIT
cat >/etc/systemd/system/rig-job.service <<UNIT
[Unit]
Description=The job
Wants=rig-world.service
After=rig-world.service stratalux-safe.service
[Service]
ExecStart=/bin/sh $root/run-job.sh $1
StandardOutput=file:/share/job.log
StandardError=inherit
UNIT
mkdir -p /etc/systemd/system/multi-user.target.wants
ln -s /etc/systemd/system/rig-job.service /etc/systemd/system/multi-user.target.wants/
ln -s /usr/lib/systemd/system/stratalux-safe.service /etc/systemd/system/multi-user.target.wants/
ln -sf /lib/systemd/system/multi-user.target /etc/systemd/system/default.target
exec /lib/systemd/systemd
