#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Boots the guest, runs one job in it and takes the job's exit status and cases back.
#   tests/rig-vm/boot.sh JOB BUILD OUT [SECONDS]
# JOB: tests/rig-vm/jobs/JOB.sh. BUILD: the build folder whose binaries the guest runs (/build there). OUT: this boot's
# folder, emptied first (/share there, the only place the guest can write to): console.log, cases, and what the job
# leaves. Exit 0: every case passed; 1: one did not, or the guest hung or died; 77: no guest on this machine.
# STRATALUX_RIG_FAULTS: how many faults the job `capture` draws by STRATALUX_SEED, how many deaths `deaths`, how many
# cases `systemd`. STRATALUX_RIG_CASE: of `systemd` this case alone, by its name in the table. STRATALUX_RIG_PATIENCE: how many
# times as long as usual everything may take, on a machine that others use (1).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
source_folder=$(cd "$here/../.." && pwd)
job=${1:?usage: boot.sh JOB BUILD OUT [SECONDS]} build=$(cd "$2" && pwd) out=${3:?} limit_s=${4:-240}
[ -f "$here/jobs/$job.sh" ] || { echo "error: no job tests/rig-vm/jobs/$job.sh" >&2; exit 2; }
patience=${STRATALUX_RIG_PATIENCE:-1}
[[ $patience =~ ^[1-9][0-9]?$ ]] || { echo "error: STRATALUX_RIG_PATIENCE=$patience is no number of 1 .. 99" >&2; exit 2; }
limit_s=$((limit_s * patience))
guest=$("$here/build-guest.sh")
rm -rf "$out"
mkdir -p "$out"
[ -z "${STRATALUX_RIG_CASE:-}" ] || echo "$STRATALUX_RIG_CASE" >"$out/case"
out=$(cd "$out" && pwd)
# What the packages hold, for a boot that installs it. Timeouts of units hold it to time: a busy emulator measures the TSC
# wrongly, by several times.
clock=
if [ -e "$here/jobs/$job.boot.sh" ]; then
  for package in stratalux-data stratalux-db stratalux-fit stratalux-rig; do
    DESTDIR=$out/installed cmake --install "$build" --prefix /usr --component $package >"$out/install.log" || { cat "$out/install.log" >&2; exit 1; }
  done
  rm -rf "$out/installed/usr/share/doc"
  # A fit's libraries, from this machine, whose Debian is the guest's: for the case that fits.
  mkdir "$out/libraries"
  ldd "$build/bin/stratalux-fit" | awk '$2 == "=>" && $3 ~ "^/" {print $1, $3}' | while read -r name file; do
    [ -e "$guest/rootfs/usr/lib/x86_64-linux-gnu/$name" ] || cp -L "$file" "$out/libraries/$name"
  done
  clock=clocksource=hpet
fi

share() {  # TAG FOLDER [OPTION]: one 9p share
  echo -fsdev "local,id=$1,path=$2,security_model=none,multidevs=remap${3:+,$3}" -device "virtio-9p-pci,fsdev=$1,mount_tag=$1"
}
# Software emulation: KVM is missing or nested on the machines that run this, and 2 of its processors are enough.
# shellcheck disable=SC2046
timeout "$limit_s" qemu-system-x86_64 -accel tcg,thread=multi,tb-size=256 -machine q35 -cpu max -smp 2 -m 1024 \
  -nodefaults -display none -no-reboot -serial "file:$out/console.log" \
  -kernel "$guest/vmlinuz" -initrd "$guest/initrd" \
  -append "console=ttyS0 quiet panic=-1 mitigations=off nokaslr random.trust_cpu=on tsc=reliable no_timer_check rig.job=$job \
rig.faults=${STRATALUX_RIG_FAULTS:-2} rig.seed=${STRATALUX_SEED:-1} rig.patience=$patience $clock" \
  $(share root "$guest/rootfs" readonly=on) $(share source "$source_folder" readonly=on) \
  $(share build "$build" readonly=on) $(share share "$out") </dev/null || emulator=$?

[ ! -f "$out/cases" ] || cat "$out/cases"
if [ -f "$out/status" ]; then exit "$(cat "$out/status")"; fi
if [ "${emulator:-0}" -eq 124 ]; then why="hung: stopped after $limit_s s"; else why="ended without a status (QEMU: ${emulator:-0})"; fi
echo "error: the guest $why; its console: $out/console.log" >&2
tail -n 25 "$out/console.log" >&2 || true
exit 1
