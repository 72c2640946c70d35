#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The life of the packages in /debs/1 and, a revision later, /debs/2: for scripts/test-packages.sh, in a clean root.
set -euo pipefail
fail() { printf 'FAILED: %s\n' "$@" >&2; exit 1; }
step() { echo "-- $*" >&2; }
install() { apt-get install -y -qq --no-install-recommends "$@" >/tmp/log 2>&1 || { tail -n 40 /tmp/log; fail "apt-get install $*"; }; }
as_rig() { runuser -u stratalux -- env STATE_DIRECTORY=/var/lib/stratalux STRATALUX_CACHE= "$@"; }
store=/var/lib/stratalux/store

step "the controller alone"
install /debs/1/stratalux-data_*.deb /debs/1/stratalux-rig_*.deb
! dpkg-query -W -f='${Package}\n' | grep -E '^lib(opencv|ceres|openexr)|^slurm' || fail "the controller brought what only others need"
[ "$(stat -c '%U:%G %a' $store)" = "stratalux:stratalux 750" ] || fail "$store is not the account's own"
[ -L /etc/systemd/system/multi-user.target.wants/stratalux-safe.service ] || fail "no light goes off at boot"
[ ! -e /etc/systemd/system/multi-user.target.wants/stratalux-kiosk.service ] || fail "a kiosk is enabled that nobody asked for"
stratalux-rig plan show >/tmp/plan
[ "$(wc -l </tmp/plan)" -gt 100 ] || fail "stratalux-rig plan show"
as_rig stratalux-rig safe 2>/dev/null && fail "safe speaks of lights where none is wired" || [ $? -eq 2 ] || fail "safe does not say that no light is known"

step "the other programs"
install /debs/1/*.deb
stratalux-db --help >/dev/null
stratalux-fit --help >/dev/null
stratalux-skin-table --help >/dev/null
for timer in purge verify; do [ -L /etc/systemd/system/timers.target.wants/stratalux-$timer.timer ] || fail "stratalux-$timer.timer is not enabled"; done
[ ! -e /etc/systemd/system/timers.target.wants/stratalux-pull.timer ] || fail "a pull is enabled that nobody told where from"
for unit in /lib/systemd/system/stratalux-*; do
  # Browser and compositor are suggested alone.
  [ "$(basename "$unit")" != stratalux-display.service ] || [ -x /usr/bin/cage ] || continue
  systemd-analyze verify --man=no "$unit" >/tmp/log 2>&1 || { cat /tmp/log; fail "$unit"; }
done
getent passwd stratalux-display >/dev/null || fail "the account of the kiosk's screen was not made"
if udevadm verify --help >/dev/null 2>&1; then udevadm verify /lib/udev/rules.d/60-stratalux.rules || fail "udevadm verify"; fi

step "a capture by the account of the rig, in the configured store"
{ printf '[rig]\nstore = "/var/lib/stratalux/store"\n[camera]\nwidth = 96\nheight = 72\n'; cat /debs/smallest_plan.toml; } >/tmp/plan.toml
# Its skin scatters light: the table is found beside the program.
as_rig stratalux-rig capture --simulate --config /tmp/plan.toml >/tmp/log 2>&1 || { tail -n 20 /tmp/log; fail "a capture"; }
as_rig stratalux-db verify --deep --store $store >/dev/null || fail "verify"

step "what a timer's service would run"
for unit in purge verify; do
  read -ra command < <(sed -n 's/^ExecStart=//p' /lib/systemd/system/stratalux-$unit.service)
  as_rig "${command[@]}" >/tmp/log 2>&1 || { cat /tmp/log; fail "stratalux-$unit.service"; }
done

step "an upgrade with a live store: one session after another is being written"
rm -f /tmp/upgraded
(
  count=0
  until [ -e /tmp/upgraded ]; do
    as_rig stratalux-rig capture --simulate --no-scattering --config /tmp/plan.toml >/tmp/capture 2>&1 || { tail -n 20 /tmp/capture; exit 1; }
    count=$((count + 1))
  done
  echo $count >/tmp/count
) &
captures=$!
echo '# mine' >>/etc/stratalux/rig.toml
install /debs/2/*.deb
touch /tmp/upgraded
wait $captures || fail "a capture under which the packages were upgraded"
grep -qx '# mine' /etc/stratalux/rig.toml || fail "the upgrade changed a configuration that somebody edited"
as_rig stratalux-db verify --deep --store $store >/dev/null || fail "verify behind the upgrade"
sessions=$(as_rig stratalux-db ls --store $store --json)
[ "$(grep -c '"complete"' <<<"$sessions")" -eq $(($(cat /tmp/count) + 1)) ] || { echo "$sessions"; fail "not $(cat /tmp/count) and one complete sessions"; }
echo "   $(cat /tmp/count) sessions were written meanwhile" >&2

step "a store of a newer program is refused with the way back"
cp -a $store /tmp/newer
python=$(command -v python3 || true)
[ -n "$python" ] || { install python3-minimal; }
python3 - <<'PYTHON'
# The two fields of the header that a newer program would leave changed: user_version is at 60.
with open("/tmp/newer/index.sqlite", "r+b") as index:
    index.seek(60)
    index.write((99).to_bytes(4, "big"))
PYTHON
cp $store/index.sqlite /tmp/newer/index-before-99.sqlite
code=0
stratalux-db ls --store /tmp/newer 2>/tmp/log || code=$?
[ $code -eq 7 ] && grep -q 'go back to /tmp/newer/index-before-99.sqlite' /tmp/log || { cat /tmp/log; fail "exit code $code"; }

step "removed: programs and units go, sessions and configuration stay"
apt-get remove -y -qq 'stratalux-*' >/tmp/log 2>&1 || { cat /tmp/log; fail "apt-get remove"; }
[ ! -e /usr/bin/stratalux-rig ] && [ ! -e /lib/systemd/system/stratalux-safe.service ] || fail "something was left"
[ -e $store/index.sqlite ] && [ -e /etc/stratalux/rig.toml ] || fail "a removal took what is the operator's"

step "purged: the configuration goes, the sessions are kept and said to be"
apt-get purge -y -qq 'stratalux-*' >/tmp/log 2>&1 || { cat /tmp/log; fail "apt-get purge"; }
grep -q "$store holds sessions and is kept" /tmp/log || { cat /tmp/log; fail "nobody says that the store is kept"; }
[ -e $store/index.sqlite ] || fail "a purge took the sessions"
[ ! -e /etc/stratalux ] || fail "a purge left /etc/stratalux"
left=$(find /etc/systemd /usr /var/lib/systemd -name '*stratalux*' 2>/dev/null || true)
[ -z "$left" ] || fail "a purge left:" "$left"

step "and installed again"
install /debs/2/*.deb
as_rig stratalux-db verify --store $store >/dev/null || fail "the store of before is not read"
. /etc/os-release
echo "packages: installed, used, upgraded, removed, purged and installed again on $PRETTY_NAME"
