#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs, builds and runs the tests. ctest's closing line ends the output.
set -euo pipefail
usage() {
  cat <<'HELP'
usage: scripts/test.sh [--unit|--integration|--style|--label L] [--asan] [--tidy] [--no-install] [-j N] [-R REGEX]
       scripts/test.sh --night [PART ...]
  --unit, --integration, --style   only these tests (ctest labels)
  --asan                           with address and undefined-behaviour sanitizers
  --tidy                           clang-tidy over the whole tree instead of tests
  --night [PART|TURN ...|all]      the whole numbers behind the tests' samples (docs/night.md): every part but those that take
                                   turns, and the day's turn; or those named, or all. STRATALUX_SEED=N chooses the draws;
                                   without it the date
  --list                           with --night: say which parts would run, of the tree as it is built
  --no-install                     do not look for missing Debian packages
HELP
}
root=$(cd "$(dirname "$0")/.." && pwd)
install=1 preset=release tidy=0 list=0 jobs='' select=() night=0 parts=()
while [ $# -gt 0 ]; do
  case "$1" in
    --unit|--integration|--style) select+=(-L "${1#--}"); shift ;;
    --label) select+=(-L "${2:?--label needs a label}"); shift 2 ;;
    --asan) preset=asan; shift ;;
    --tidy) tidy=1; shift ;;
    --no-install) install=0; shift ;;
    --list) list=1; shift ;;
    -j) jobs=${2:?-j needs a number}; shift 2 ;;
    -R) select+=(-R "${2:?-R needs a regular expression}"); shift 2 ;;
    --night) night=1; shift; while [ $# -gt 0 ] && [ "${1#-}" = "$1" ]; do parts+=("$1"); shift; done ;;
    -h|--help) usage; exit 0 ;;
    *) echo "error: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
done
[ $list -eq 0 ] || [ $night -eq 1 ] || { echo "error: --list needs --night" >&2; exit 2; }
# Some tests wait more than they compute.
cores=${jobs:-$(nproc)} jobs=${jobs:-$(($(nproc) + 1))}
# What the build needs comes first, what only tests need while it builds.
rest=
finish_installing() {
  local pid=$rest
  [ -n "$pid" ] || return 0
  rest=
  wait "$pid" || { cat "$rest_log" >&2; echo "error: scripts/install-deps.sh failed" >&2; return 1; }
}
if [ $install -eq 1 ] && [ $list -eq 0 ]; then
  "$root/scripts/install-deps.sh" --groups rig,fit,test
  echo "test.sh: what the build needs is installed after $SECONDS s" >&2
  rest_log=$(mktemp)
  trap 'finish_installing || true; rm -f "$rest_log"' EXIT
  "$root/scripts/install-deps.sh" >"$rest_log" 2>&1 &
  rest=$!
fi
cd "$root"
[ $list -eq 1 ] || cmake --preset "$preset"
if [ $tidy -eq 1 ]; then
  command -v clang-tidy >/dev/null || { echo "error: clang-tidy is not installed (apt-get install clang-tidy)" >&2; exit 1; }
  git ls-files '*.cc' | xargs -r -P "$cores" -n 4 clang-tidy -quiet -p "build/$preset"
  exit 0
fi
[ $list -eq 1 ] || cmake --build --preset "$preset" -j "$cores"
finish_installing
[ $list -eq 1 ] || echo "test.sh: built after $SECONDS s" >&2
if [ $night -eq 1 ]; then
  export STRATALUX_SEED=${STRATALUX_SEED:-$(date +%Y%m%d)}
  echo "seed $STRATALUX_SEED" >&2
  # parts_of [LABEL]: the night's parts, a line each.
  parts_of() { ctest --test-dir "build/$preset" -C night -L "^night\$" ${1:+-L "^$1\$"} -N | sed -n 's/.*: night\.//p'; }
  known=$(parts_of)
  turns=$(ctest --test-dir "build/$preset" -C night -L night --print-labels | sed -n 's/^ *turn\.//p')
  if [ ${#parts[@]} -eq 0 ]; then
    mapfile -t turn_names <<<"$turns"
    turn=${turn_names[10#$(date +%j) % ${#turn_names[@]}]}
    echo "tonight's turn: $turn" >&2
    select+=(-LE "^turn\.($(grep -vx "$turn" <<<"$turns" | paste -sd '|'))\$")
  elif [ "${parts[*]}" != all ]; then
    named=()
    for part in "${parts[@]}"; do
      if grep -qx -- "$part" <<<"$turns"; then
        mapfile -t -O ${#named[@]} named < <(parts_of "turn\.$part")
      elif grep -qx -- "$part" <<<"$known"; then
        named+=("$part")
      else
        echo "error: no part '$part' of the night; parts: $(tr '\n' ' ' <<<"$known"); turns: $(tr '\n' ' ' <<<"$turns")" >&2
        exit 2
      fi
    done
    select+=(-R "^night\.($(IFS='|'; echo "${named[*]}"))\$")
  fi
  if [ $list -eq 1 ]; then
    ctest --test-dir "build/$preset" -C night -L "^night\$" "${select[@]}" -N | sed -n 's/.*: night\.//p'
    exit 0
  fi
  # Small stores by the thousand, every write synced: in memory, where there is room and nobody said where else.
  if [ -z "${TMPDIR:-}" ] && [ "$(df --output=avail -B 1G /dev/shm 2>/dev/null | tail -n 1)" -ge 4 ]; then
    TMPDIR=$(mktemp -d /dev/shm/stratalux-night.XXXXXX)
    export TMPDIR
    trap 'rm -rf "$TMPDIR" ${rest_log:+"$rest_log"}' EXIT
  fi
  status=0
  ctest --test-dir "build/$preset" -C night -L "^night\$" --output-on-failure -V -j "$jobs" "${select[@]}" || status=$?
  exit $status
fi
rm -f "build/$preset"/rig-vm/*/cases "build/$preset/tests/results.xml"
results=build/$preset/tests/results.xml
status=0
ctest --test-dir "build/$preset" --output-on-failure --output-junit "$root/$results" -j "$jobs" "${select[@]}" || status=$?
# What the virtual machine's boots saw, a line a case (docs/rig-vm.md).
for cases in "build/$preset"/rig-vm/*/cases; do
  [ ! -f "$cases" ] || { echo "$cases:"; cat "$cases"; } >&2
done
# Once more at the end, where a log of thousands of lines is read first.
[ $status -eq 0 ] || [ ! -f "$results" ] || python3 - "$results" >&2 <<'PYTHON'
import sys, xml.etree.ElementTree as xml
for case in xml.parse(sys.argv[1]).getroot().iter("testcase"):
    if case.get("status") == "fail":
        print(f"--- {case.get('name')}, how it ended:", *case.findtext("system-out", "").splitlines()[-25:], sep="\n")
PYTHON
exit $status
