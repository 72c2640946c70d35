#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What the units, accounts, folders and rules of systemd/ promise, held by systemd's own tools. Exit 77: a tool is missing.
#   check-units.sh security|verify|programs|page|accounts|rules|pull|keys SOURCE BUILD
set -euo pipefail
check=$1 source=$2 build=$3
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
fail() { printf 'FAILED: %s\n' "$@" >&2; exit 1; }
need() { command -v "$1" >/dev/null || { echo "skipped: $1 is not installed: scripts/install-deps.sh" >&2; exit 77; }; }
installed() {
  # The configuration's place is /etc whatever the prefix is: its package goes by DESTDIR.
  { cmake --install "$build" --prefix "$scratch/usr" --component stratalux-db && cmake --install "$build" --prefix "$scratch/usr" --component stratalux-rig &&
    cmake --install "$build" --prefix "$scratch/usr" --component stratalux-fit &&
    DESTDIR=$scratch cmake --install "$build" --prefix /usr --component stratalux-data; } >"$scratch/log" || { cat "$scratch/log"; fail "cmake --install"; }
}

# Tenths of systemd's points of exposure that a unit may have, by what it has to reach.
limit_of() {
  case "$1" in
    stratalux-kiosk|stratalux-safe) echo 15 ;;   # devices
    stratalux-purge|stratalux-verify|stratalux-batch|stratalux-keys) echo 5 ;;  # neither devices nor network
    stratalux-pull|stratalux-submit) echo 15 ;;  # network
    stratalux-display) echo 75 ;;                # a browser, which has a sandbox of its own
    *) fail "$1.service has no limit of exposure in ${BASH_SOURCE[0]}" ;;
  esac
}
exposed() { systemd-analyze security --offline=yes --threshold="$2" "$1" >"$scratch/said" 2>&1; }
security() {
  need systemd-analyze
  for unit in "$source"/systemd/*.service; do
    name=$(basename "$unit" .service)
    limit=$(limit_of "$name")
    exposed "$unit" "$limit" || { grep '✗' "$scratch/said" || true; fail "$name: $(tail -n 1 "$scratch/said"); at most $limit tenths"; }
    tail -n 1 "$scratch/said"
  done
  grep -v PrivateNetwork "$source/systemd/stratalux-purge.service" >"$scratch/stratalux-purge.service"
  ! exposed "$scratch/stratalux-purge.service" 5 || fail "a purge with a network passes for one without"
}

verify() {
  need systemd-analyze
  installed
  units=$scratch/usr/lib/systemd/system
  # What is not of ours need not be on this machine.
  sed 's:=/usr/bin/cage -d -- /usr/bin/chromium:=/bin/true:' "$source/systemd/stratalux-display.service" >"$units/stratalux-display.service"
  [ -e "$units/stratalux-kiosk.service" ] ||
    sed 's:=/usr/bin/stratalux-rig:=/bin/true:' "$source/systemd/stratalux-kiosk.service" >"$units/stratalux-kiosk.service"
  systemd-analyze verify --man=no "$units"/* >"$scratch/said" 2>&1 || { cat "$scratch/said"; fail "systemd-analyze verify"; }
  [ ! -s "$scratch/said" ] || { cat "$scratch/said"; fail "systemd-analyze verify is not silent"; }
  sed -i 's/^Nice=/Nyce=/' "$units/stratalux-purge.service"
  systemd-analyze verify --man=no "$units/stratalux-purge.service" >"$scratch/said" 2>&1 || true
  grep -q "Nyce" "$scratch/said" || fail "an unknown key passes"
}

# No unit is installed that calls a program, verb or option that is not there.
programs() {
  installed
  count=0
  while IFS= read -r line; do
    words=${line#*=}
    words=${words#-}  # whose failure ends nothing
    # shellcheck disable=SC2086
    set -- $words
    case "$1" in
      "$scratch"/*) ;;
      /usr/bin/test) continue ;;  # coreutils, which every Debian has
      /usr/bin/cage) continue ;;  # a package that is suggested, of which `page` knows more
      *) fail "$line: $1 is none of ours" ;;
    esac
    [ -x "$1" ] || fail "$line: no program $1"
    case "$1" in */stratalux-*) ;; *) continue ;; esac
    verb=()
    for word in "${@:2}"; do case "$word" in -*) break ;; esac; verb+=("$word"); done
    "$1" "${verb[@]}" --help >"$scratch/help" || fail "$line: $1 has no verb ${verb[*]}"
    for word in "$@"; do
      case "$word" in --*) grep -q -- "$word\b" "$scratch/help" || fail "$line: ${verb[*]} has no option $word" ;; esac
    done
    count=$((count + 1))
  done < <(grep -hE '^Exec[A-Za-z]*=' "$scratch/usr/lib/systemd/system/"*.service)
  [ $count -ge 4 ] || fail "only $count commands in all units"
  # systemd 252 leaves a timer waiting for ever whose unit's Condition did not hold: it is not begun, so it does not end.
  for timer in "$scratch"/usr/lib/systemd/system/*.timer; do
    ! grep -E '^(Condition|Assert)' "${timer%.timer}.service" || fail "${timer%.timer}.service: a timer's unit asks by ExecCondition="
    # Begun behind that time, by Restart= or a slow pull, it would go on until the next day's.
    ! grep -E '^ExecStart=.* --until ' "${timer%.timer}.service" | grep -v -- ' --from ' || fail "${timer%.timer}.service: --until without --from"
  done
  echo "$count commands, all known"
}

# The screen shows what the kiosk of the shipped configuration serves, and comes back when browser or controller do.
page() {
  installed
  unit=$scratch/usr/lib/systemd/system/stratalux-display.service
  toml=$source/docs/examples/rig.toml
  value() { sed -n "/^\[kiosk.page\]/,/^\[plan\]/s/^$1 = \"\{0,1\}\([^\" ]*\).*/\1/p" "$toml"; }
  is=$(sed -n 's/^Environment=STRATALUX_PAGE=//p' "$unit")
  [ "$is" = "http://$(value address):$(value port)/" ] || fail "the screen looks at $is, the kiosk serves $(value address) port $(value port)"
  grep -q '^Restart=always$' "$unit" || fail "a browser that ends stays away"
  ! grep -qE '^(PartOf|BindsTo|Requires)=.*stratalux-kiosk' "$unit" || fail "a controller that is stopped takes the screen for good"
  [ -e "$scratch/usr/lib/pam.d/$(sed -n 's/^PAMName=//p' "$unit")" ] || fail "no PAM service of its name"
  grep -q "^u $(sed -n 's/^User=//p' "$unit") " "$scratch"/usr/lib/sysusers.d/*.conf || fail "nobody makes its account"
}

# Every account of a unit exists after systemd-sysusers, and systemd-tmpfiles makes the store's folder its own.
accounts() {
  need systemd-sysusers
  need systemd-tmpfiles
  root=$scratch/root
  mkdir -p "$root/etc"
  systemd-sysusers --root="$root" --dry-run "$source"/systemd/*.sysusers.conf || fail "systemd-sysusers --dry-run"
  systemd-sysusers --root="$root" "$source"/systemd/*.sysusers.conf || fail "systemd-sysusers"
  for kind in User:passwd Group:group; do
    for account in $(sed -n "s/^${kind%:*}=//p" "$source"/systemd/*.service | sort -u); do
      grep -q "^$account:" "$root/etc/${kind#*:}" || fail "${kind%:*}=$account of a unit is made by no sysusers file"
    done
  done
  [ "$(id -u)" -eq 0 ] || { echo "skipped: only root can give folders to another account" >&2; exit 77; }
  systemd-tmpfiles --root="$root" --create "$source/systemd/stratalux.tmpfiles.conf" || fail "systemd-tmpfiles"
  id=$(awk -F: '$1 == "stratalux" {print $3 ":" $4}' "$root/etc/passwd")
  for folder in /var/lib/stratalux /var/lib/stratalux/store; do
    is=$(stat -c '%u:%g %a' "$root$folder") || fail "$folder was not made"
    [ "$is" = "$id 750" ] || fail "$folder is $is, not $id 750"
  done
  # What is there stays, with its owner.
  touch "$root/var/lib/stratalux/store/index.sqlite"
  systemd-tmpfiles --root="$root" --create --remove --clean "$source/systemd/stratalux.tmpfiles.conf"
  [ -e "$root/var/lib/stratalux/store/index.sqlite" ] || fail "systemd-tmpfiles removed a store"
}

# udev itself applies the rules, to the kernel's own /dev/null in the camera's place: in a name space in which /dev, /run and
# the groups are the test's, for `udevadm test` changes what it finds.
rules() {
  need udevadm
  [ -d /sys/class/mem/null ] || { echo "skipped: no /sys" >&2; exit 77; }
  name_space="unshare --mount --propagation private"
  [ "$(id -u)" -eq 0 ] || name_space="unshare --map-root-user --mount"
  $name_space true 2>/dev/null || { echo "skipped: no mount name space for this account" >&2; exit 77; }
  if udevadm --help | grep '^ *verify' >/dev/null; then
    udevadm verify --resolve-names=never "$source/systemd/60-stratalux.rules" "$source/docs/examples/59-stratalux-rig.rules"
  fi
  mkdir "$scratch/rules"
  sed 's/SUBSYSTEM=="gpio", KERNEL=="gpiochip\*"/SUBSYSTEM=="mem", KERNEL=="null"/' "$source/systemd/60-stratalux.rules" >"$scratch/rules/60-stratalux.rules"
  cp "$source/docs/examples/59-stratalux-rig.rules" "$scratch/rules/"
  { cat /etc/group; echo stratalux:x:4242:; } >"$scratch/group"
  apply() {
    $name_space bash -e -c '
      mount -t tmpfs none /run
      mkdir -p /run/udev
      cp -r "$1/rules" /run/udev/rules.d
      mount --bind "$1/group" /etc/group
      mount -t tmpfs none /dev
      udevadm test /sys/class/mem/null 2>&1' apply "$scratch" >"$scratch/said" || { cat "$scratch/said"; fail "udevadm test"; }
  }
  apply
  ! grep -E 'stratalux[^ ]*:[0-9]+:? (Unknown|Invalid|invalid|Failed)' "$scratch/said" || fail "udev does not understand the rules"
  ! grep -q 'stratalux/lines' "$scratch/said" || fail "a device that nobody marked becomes the rig's"
  echo 'SUBSYSTEM=="mem", KERNEL=="null", ENV{STRATALUX}="lines"' >>"$scratch/rules/59-stratalux-rig.rules"
  apply
  grep -q "GROUP 4242" "$scratch/said" || { cat "$scratch/said"; fail "a marked device does not become the group's"; }
  grep -q "LINK 'stratalux/lines'" "$scratch/said" || fail "a marked device has no stable name"
}

# systemd makes a word of each rig that is named (systemd.service, "Command lines": $WORD, not ${WORD}).
rigs() {
  grep -q -- '--from \$STRATALUX_PULL_FROM$' "$source/systemd/stratalux-pull.service" || fail "several rigs would be one word"
}

# stratalux-pull.service sees no key, and needs none: encrypted sessions arrive whole, hashed and not decoded.
pull() {
  rigs
  for name in pull submit; do
    grep -q '^InaccessiblePaths=-/var/lib/stratalux/store/keys.sqlite$' "$source/systemd/stratalux-$name.service" || fail "$name sees keys"
  done
  as_other=""
  if [ "$(id -u)" -eq 0 ]; then
    need setpriv
    as_other="setpriv --reuid=65534 --regid=65534 --clear-groups"
  fi
  cp "$build/bin/stratalux-db" "$scratch/"  # where any account may run it
  chmod 755 "$scratch"
  { printf '[camera]\nwidth = 96\nheight = 72\n'; cat "$source/tests/support/smallest_plan.toml"; } >"$scratch/tiny.toml"
  mkdir "$scratch/state"
  STATE_DIRECTORY=$scratch/state STRATALUX_CACHE='' "$build/bin/stratalux-rig" capture --simulate --no-scattering --encrypt --config "$scratch/tiny.toml" \
    --store "$scratch/rig" >"$scratch/log" 2>&1 || { cat "$scratch/log"; fail "a capture"; }
  "$build/bin/stratalux-db" init --store "$scratch/here" >/dev/null
  cp "$scratch/rig/keys.sqlite" "$scratch/here/"
  [ -z "$as_other" ] || chown -R 65534:65534 "$scratch/rig" "$scratch/here"
  chmod 000 "$scratch/here/keys.sqlite" "$scratch/rig/keys.sqlite"
  $as_other "$scratch/stratalux-db" pull --store "$scratch/here" --from "$scratch/rig" >"$scratch/said" 2>&1 || { cat "$scratch/said"; fail "a pull without keys"; }
  grep -q "^1 sessions pulled" "$scratch/said" || { cat "$scratch/said"; fail "nothing was pulled"; }
  decoded() { $as_other "$scratch/stratalux-db" verify --deep --store "$scratch/here" >"$scratch/said" 2>&1 && ! grep -q "not decoded" "$scratch/said"; }
  ! decoded || fail "the key was not out of reach: the test proves nothing"
  chmod 600 "$scratch/here/keys.sqlite"
  decoded || { cat "$scratch/said"; fail "what was pulled cannot be read by who has the key"; }
}

# The reader's private key is that of the batch and of who answers a cluster's tasks alone, which have no network; a machine without one begins its night all the same.
keys() {
  units=$source/systemd
  with=$(cd "$units" && grep -lE '^(LoadCredential|LoadCredentialEncrypted|SetCredential|ImportCredential)' ./*.service || true)
  [ "$with" = $'./stratalux-batch.service\n./stratalux-keys.service' ] || fail "credentials are given to: $with"
  for unit in $with; do
    grep -q '^PrivateNetwork=yes$' "$units/$unit" || fail "$unit has the reader's key and a network"
    # With a path, a file that is missing would fail the unit (systemd.exec).
    grep -q '^LoadCredential=reader.key$' "$units/$unit" || fail "$unit gets no reader.key, or fails without one"
  done
  # Tasks ask where somebody answers.
  results_of() { grep -o -- '--results [^ ]*' "$units/stratalux-$1.service"; }
  [ "$(results_of keys)" = "$(results_of submit)" ] || fail "$(results_of submit) asks, $(results_of keys) is answered"
  grep -q '^ExecStart=.* --ask-keys' "$units/stratalux-submit.service" || fail "tasks do not ask for keys"
  grep -q '^Wants=.*stratalux-keys.service' "$units/stratalux-submit.service" || fail "nobody is started who answers"
  ! grep -h '^Environment.*STRATALUX_READER_KEY' "$units"/*.service || fail "a unit names a reader's key"
  # A night begins behind the pull, whatever became of that.
  for name in batch submit; do
    for word in Wants After; do
      grep -qE "^$word=.*stratalux-pull.service" "$units/stratalux-$name.service" || fail "$name does not come behind the pull ($word)"
    done
    ! grep -qE '^(Requires|BindsTo|Requisite)=.*stratalux-pull' "$units/stratalux-$name.service" || fail "a pull that failed ends the night"
  done
}

case "$check" in
  security|verify|programs|page|accounts|rules|pull|keys) $check ;;
  *) echo "usage: check-units.sh security|verify|programs|page|accounts|rules|pull|keys SOURCE BUILD" >&2; exit 2 ;;
esac
