#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# `stratalux-rig capture` on the kernel's interfaces, in front of a scene that shows what the projectors are told
# (responder.cc): a plan of 204 frames, then `rig.faults` of the faults, drawn by `rig.seed`. A row each:
#   fault | injected | detected as | session | frames proven | mis-associated
. /source/tests/rig-vm/guest-lib.sh

plan=/source/tests/rig-vm/plans/loop.toml
export STATE_DIRECTORY=/tmp/state  # as systemd's: the controller leaves the rig's lights there
mkdir -p "$STATE_DIRECTORY"
short_plan=/tmp/short.toml  # references, codes and guards: what a fault needs to be seen
sed 's/^kind = "visitor"/kind = "calibration"/' "$plan" >$short_plan

# capture NAME PLAN WANTED FAULT...: WANTED lists the session's allowed ends; a fault must leave a sign. `control`, if
# set, is given to vivid just before the capture; `always`, if set, before each try. A capture whose camera lost frames
# because the emulator stalled, before its pre-roll was past or where there was to be no fault, shows nothing: it is taken
# again, twice at most, and its row says so. (The kernel's camera numbers what it delivers: a number that the controller
# itself got wrong would be missing in every try.)
capture() {
  local tries=1 row
  until capture_once "$tries" "$@"; do
    { stalled "$@" && [ "$tries" -lt 3 ]; } || {
      failures=$((failures + 1))
      break
    }
    tries=$((tries + 1))
    load_camera  # what the fault set would meet the next try in its pre-roll
  done
  [ "$tries" -eq 1 ] || row="$row | try $tries"
  echo "$row" >>$cases
}
stalled() {
  case "$reason" in "pre-roll: no unbroken marker code"*) return 0 ;; esac
  [ $# -eq 3 ] && [ -z "$control" ] || return 1
  case "$detected" in *,*) return 1 ;; "sequence gap: "*) return 0 ;; esac
  return 1
}
# One try; leaves `row`, `detected` and `reason`, fails where the verdict does.
capture_once() {
  local name="$2" config="$3" wanted="$4" out="/share/$2${1#1}" responder subject ended judged verdict
  shift 4
  rm -rf "$out"
  mkdir "$out"
  /build/bin/rig-vm-responder "$config" "$screen" "$@" >"$out/responder.log" 2>&1 &
  responder=$!
  until grep -qs ready "$out/responder.log"; do
    kill -0 $responder 2>/dev/null || break
    sleep 0.2
  done
  [ -z "$always$control" ] || v4l2-ctl -d "$camera" -c "$always$control"
  # One pose of a board: the guided series would ask for an answer.
  subject="--pose 0"
  [ "$config" = $short_plan ] || subject="--visitor loop-1 --consent-scope fit --consent-text test --consent-language en"
  rm -rf /tmp/store
  # A busy machine's emulator takes minutes. No calibration: its warning would pass for a fault's sign.
  # shellcheck disable=SC2086
  timeout 300 /build/bin/stratalux-rig capture --config "$config" --store /tmp/store $subject --calibration none --json \
    >"$out/outcome.json" 2>"$out/rig.log"
  ended=$?
  kill $responder 2>/dev/null
  wait $responder
  judged=$(/build/bin/rig-vm-judge /tmp/store 2>>"$out/rig.log") || judged="${judged:-0 ?}"
  session=$(sed -nE 's/.*"status": "([a-z]+)".*/\1/p' "$out/outcome.json")
  detected=$(awk '/"faults": \{$/ {on=1; next} on && /\}/ {exit} on {gsub(/[",]/, ""); $1=$1; printf "%s%s", sep, $0; sep=", "}' "$out/outcome.json")
  reason=$(awk '/"reasons": \[$/ {getline; gsub(/^ *"|",?$/, ""); print; exit}' "$out/outcome.json" | cut -c1-80)
  detected=${detected:-$(sed -nE 's/^warning: //p' "$out/rig.log" | head -n 1 | cut -c1-80)}
  verdict="ok     "
  case " $wanted " in *" ${session:-none} "*) ;; *) verdict="FAILED " ;; esac
  [ "${judged#* }" = 0 ] || verdict="FAILED "
  [ $# -eq 0 ] && [ -z "$control" ] || [ -n "$detected$reason" ] || verdict="FAILED "
  row=$(printf '%s %-22s | %-42s | %s%s | %s (exit %s) | %s | %s' "$verdict" "$name" "${*:-${control:-none}}" \
    "${detected:-nothing}" "${reason:+; $reason}" "${session:-none}" "$ended" "${judged% *}" "${judged#* }")
  [ "$verdict" = "ok     " ]
}

# name; plan; allowed ends of the session; control of vivid given before the capture; fault of the responder.
faults() {
  sed 's/ *; */;/g' <<'ROWS'
swapped patterns      ; whole ; degraded          ;                                ; swap@60
bit for its inverse   ; short ; degraded          ;                                ; swap@126
no step               ; short ; complete degraded ;                                ; no-step@30
lost edge             ; short ; complete degraded ;                                ; lost-edge@30
doubled edge          ; short ; complete degraded ;                                ; doubled-edge@30
stuck SYNC            ; short ; degraded failed   ;                                ; stuck-sync@30
dropped buffers       ; short ; complete degraded ;                                ; control:Percentage of Dropped Buffers=10@20
buffer error flag     ; short ; complete degraded ;                                ; control:Inject V4L2_BUF_FLAG_ERROR=1@30
QBUF error            ; short ; complete degraded ;                                ; control:Inject VIDIOC_QBUF Error=1@30
fatal streaming error ; short ; complete degraded ;                                ; control:Inject Fatal Streaming Error=1@30
STREAMON error        ; short ; complete degraded ; inject_vidioc_streamon_error=1 ;
time stamps wrap      ; short ; degraded failed   ; wrap_timestamp=1               ;
emergency stop        ; short ; failed            ;                                ; emergency-stop@30
door                  ; short ; failed            ;                                ; door@30
lines unplugged       ; short ; failed            ;                                ; unplug@30
camera unplugged      ; short ; degraded failed   ;                                ; control:Disconnect=1@30
ROWS
}
modprobe gpio-sim
load_camera
echo "        fault | injected | detected as | session | frames proven | mis-associated" >$cases
capture "none, 204 frames" "$plan" "complete"
/build/bin/stratalux-db verify --deep --store /tmp/store latest >/share/verify.log 2>&1 || {
  echo "FAILED  stratalux-db verify --deep" >>$cases
  failures=$((failures + 1))
}
# A wrap of the numbers is no fault: they go on.
always=wrap_sequence_number=1
capture "sequence wraps" $short_plan "complete"
always=
faults | sample "$(option faults)" "$(option seed)" >/tmp/faults
while IFS=';' read -r name which wanted control fault; do
  load_camera
  [ "$which" = whole ] && chosen=$plan || chosen=$short_plan
  if [ -n "$fault" ]; then set -- "$fault"; else set --; fi
  capture "$name" "$chosen" "$wanted" "$@" </dev/null
done </tmp/faults
finish
