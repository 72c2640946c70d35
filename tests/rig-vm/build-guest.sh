#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds the virtual machine's guest from Debian packages, without installing any: the stock kernel, the simulated
# devices Debian leaves out of it (gpio-sim, vimc, vkms, built from linux-source) and a small root file system.
#   tests/rig-vm/build-guest.sh       prints the folder that holds vmlinuz, initrd and rootfs/; built once, then cached
# Cached in ${STRATALUX_VM_CACHE:-${XDG_CACHE_HOME:-~/.cache}/stratalux/rig-vm} under a key of everything that goes in:
# the packages apt would fetch now (name, version, hash) and this folder's scripts. Exit 77: this machine cannot build it.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
cache=${STRATALUX_VM_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/stratalux/rig-vm}
cannot() { echo "skipped: $1" >&2; exit 77; }
fail() { echo "error: $1" >&2; exit 1; }

[ "$(dpkg --print-architecture 2>/dev/null)" = amd64 ] || cannot "the guest is built from Debian's amd64 packages"
for tool in qemu-system-x86_64 busybox cpio depmod make gcc; do
  command -v "$tool" >/dev/null || cannot "$tool is missing (scripts/install-deps.sh)"
done

guest_packages() {  # what the guest's programs need at run time, a purpose each; A|B: as this Debian names it
  cat <<'LIST'
busybox-static             shell and tools of the guest
kmod                       loads and unloads modules with what they need
systemd                    first program of the boot `systemd`, whose units are tried
dbus                       the kiosk's account asks systemd by it
udev                       libcamera finds its devices through it; names and rights of the rig's
v4l-utils                  v4l2-ctl sets the controls of vivid that inject faults
libstdc++6                 every program
libpng16-16t64|libpng16-16 stratalux-rig
libjpeg62-turbo            stratalux-rig: the kiosk's live picture
libqrencode4               stratalux-rig: the kiosk's tickets
libsqlite3-0               stratalux-rig
libmicrohttpd12t64|libmicrohttpd12   stratalux-rig, stratalux-db serve
libtomlplusplus3t64|libtomlplusplus3 stratalux-rig
libtiff6                   stratalux-db
libsodium23                stratalux-rig
libxxhash0                 stratalux-rig
libzstd1                   stratalux-rig
libgpiod3|libgpiod2        stratalux-rig: lines
libdrm2                    stratalux-rig: KMS display
libcamera0.4|libcamera0.0.3 stratalux-rig: libcamera
libcamera-ipa              libcamera's module for vimc
gpiod                      second opinion on the lines
LIST
}
# Of all names at once: each question takes apt a second.
known=" $(guest_packages | awk '{gsub(/\|/, " ", $1); print $1}' | xargs apt-cache show --no-all-versions 2>/dev/null | sed -n 's/^Package: //p' | tr '\n' ' ') "
as_named_here() {  # A|B: the first that apt knows, else the last
  local name
  for name in ${1//|/ }; do [[ $known != *" $name "* ]] || break; done
  echo "$name"
}

# apt resolves the guest as if nothing were installed, and keeps its state to itself.
mkdir -p "$cache"/{debs/partial,apt/empty/partial}
exec 9>"$cache/lock"
flock 9
: >"$cache/apt/status"
apt_options=(-qq -y --no-install-recommends -o Debug::NoLocking=1 -o APT::Sandbox::User=root
             -o Dir::Cache="$cache/apt" -o Dir::State::status="$cache/apt/status")
kernel=$(apt-cache show --no-all-versions linux-image-amd64 2>/dev/null |
         sed -nE 's/^Depends:.*linux-image-([0-9][^ ,]*-amd64).*/\1/p')
[ -n "$kernel" ] || cannot "apt knows no linux-image-amd64 (apt-get update)"
version=$(apt-cache show --no-all-versions "linux-image-$kernel" | sed -n 's/^Version: //p')
series=$(cut -d. -f1,2 <<<"$kernel")
kbuild=$(apt-cache show --no-all-versions "linux-headers-$kernel" | sed -nE 's/^Depends:.*(linux-kbuild-[^ ,]*).*/\1/p')
# Tools of any version build for these headers: for days a security update has them before the signed kernel follows.
kernel_packages=("linux-image-$kernel=$version" "linux-headers-$kernel=$version"
                 "linux-headers-${kernel%-amd64}-common=$version" "$kbuild" "linux-source-$series=$version")
mapfile -t guest < <(guest_packages | while read -r names _; do as_named_here "$names"; done)
fetch() {  # FOLDER [OPTION]: the packages into FOLDER; with --print-uris only names those it does not hold yet
  cd "$1" && apt-get download "${apt_options[@]}" ${2:+"$2"} "${kernel_packages[@]}" &&
    apt-get install "${apt_options[@]}" -o Dir::Cache::archives="$1" "${2:---download-only}" "${guest[@]}"
}
wanted=$(fetch "$cache/apt/empty" --print-uris) || cannot "apt cannot name the guest's packages"

key=$({ awk '{print $2, $4}' <<<"$wanted" | sort; cat "$here"/build-guest.sh "$here"/initrd-init.sh; } | sha256sum | cut -c1-16)
guest_folder=$cache/$key
if [ -f "$guest_folder/complete" ]; then touch "$guest_folder/complete"; echo "$guest_folder"; exit 0; fi

echo "building the guest: kernel $kernel ($version)" >&2
work=$(mktemp -d "$cache/building.XXXXXX")
trap 'rm -rf "$work"' EXIT
(fetch "$cache/debs") >"$work/apt.log" 2>&1 || { cat "$work/apt.log" >&2; cannot "the guest's packages cannot be fetched"; }
# The list names each file as apt stores it; older files of the cache go.
mapfile -t files < <(awk '{print $2}' <<<"$wanted")
for deb in "$cache"/debs/*.deb; do
  printf '%s\n' "${files[@]}" | grep -qxF "$(basename "$deb")" || rm -f "$deb"
done
# /bin and the like are in /usr, as on installed systems; packages of either way meet there.
unpack() {  # PACKAGE FOLDER
  dpkg-deb --fsys-tarfile "$1" | tar -x --keep-directory-symlink -C "$2"
}
for folder in kernel rootfs; do
  for part in bin sbin lib lib64; do
    mkdir -p "$work/$folder/usr/$part"
    ln -s "usr/$part" "$work/$folder/$part"
  done
done
for file in "${files[@]}"; do
  case "$file" in
    linux-*) unpack "$cache/debs/$file" "$work/kernel" ;;
    *) unpack "$cache/debs/$file" "$work/rootfs" ;;
  esac
done

# The absent modules, against the headers of the very same version. The headers' Makefile knows only /usr/src.
headers=$work/kernel/usr/src/linux-headers-$kernel
sed -i "s#/usr/src/#$work/kernel/usr/src/#" "$headers/Makefile"
source=linux-source-$series
tar -xJf "$work/kernel/usr/src/$source.tar.xz" -C "$work" "$source/drivers/gpio/gpio-sim.c" "$source/drivers/gpio/gpiolib.h" \
  "$source/drivers/media/test-drivers/vimc" "$source/drivers/gpu/drm/vkms" "$source/kernel/irq/irq_sim.c"
modules=$work/modules
mkdir -p "$modules"/{irq,gpio}
cp "$work/$source/kernel/irq/irq_sim.c" "$modules/irq/"
cp "$work/$source"/drivers/gpio/gpio* "$modules/gpio/"
cp -r "$work/$source/drivers/media/test-drivers/vimc" "$work/$source/drivers/gpu/drm/vkms" "$modules/"
# irq_to_desc is not exported to modules; the same descriptor is reached through its irq_data.
sed -i 's/irq_to_desc(irqnum)/irq_data_to_desc(irq_get_irq_data(irqnum))/' "$modules/irq/irq_sim.c"
echo 'MODULE_LICENSE("GPL");' >>"$modules/irq/irq_sim.c"
echo 'obj-m += irq_sim.o' >"$modules/irq/Makefile"
echo 'obj-m += gpio-sim.o' >"$modules/gpio/Makefile"
sed -i 's/obj-$(CONFIG_[A-Z_]*)/obj-m/' "$modules/vimc/Makefile" "$modules/vkms/Makefile"
echo 'obj-m += irq/ gpio/ vimc/ vkms/' >"$modules/Kbuild"
# No type information (BTF) of the modules: nothing of ours reads it, and it takes pahole.
make -s -j"$(nproc)" -C "$headers" M="$modules" CONFIG_DEBUG_INFO_BTF_MODULES= modules >"$work/modules.log" 2>&1 ||
  { tail -20 "$work/modules.log" >&2; fail "the modules of kernel $kernel do not build"; }

cp -r "$work/kernel/lib/modules" "$work/rootfs/lib/"
mkdir -p "$work/rootfs/lib/modules/$kernel/extra" "$work/rootfs"/{dev,proc,sys,run,tmp,share,source,build}
find "$modules" -name '*.ko' -exec cp -t "$work/rootfs/lib/modules/$kernel/extra" {} +
strip -g "$work/rootfs/lib/modules/$kernel"/extra/*.ko
depmod -b "$work/rootfs" "$kernel"
for applet in $(busybox --list); do
  for folder in bin sbin usr/bin usr/sbin; do [ ! -e "$work/rootfs/$folder/$applet" ] || continue 2; done
  ln -s busybox "$work/rootfs/bin/$applet"
done

# The first file system holds just what reaches the root over 9p.
initrd=$work/initrd.d
mkdir -p "$initrd"/{bin,dev,proc,sys,modules,lower,upper,root}
cp "$work/rootfs/bin/busybox" "$initrd/bin/"
for applet in sh mount mkdir insmod switch_root cat; do ln -s busybox "$initrd/bin/$applet"; done
cp "$here/initrd-init.sh" "$initrd/init"
chmod 755 "$initrd/init"
for module in virtio_pci 9p 9pnet_virtio overlay; do
  modprobe -d "$work/rootfs" -S "$kernel" --show-depends "$module"
done | awk '$1 == "insmod" && !seen[$2]++ {print $2}' | while read -r file; do
  cp "$file" "$initrd/modules/"
  basename "$file"
done >"$initrd/modules/order"
(cd "$initrd" && find . | cpio -o -H newc --quiet | gzip -1) >"$work/initrd"

mkdir "$work/guest"
mv "$work/rootfs" "$work/initrd" "$work/guest/"
cp "$work/kernel/boot/vmlinuz-$kernel" "$work/guest/vmlinuz"
echo "$kernel $version" >"$work/guest/complete"
mv "$work/guest" "$guest_folder"
# Guests no checkout has used for a week go.
find "$cache" -mindepth 2 -maxdepth 2 -name complete -mtime +7 -printf '%h\n' | xargs -r rm -rf
echo "$guest_folder"
