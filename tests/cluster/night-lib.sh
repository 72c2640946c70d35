# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash disable=SC2034,SC2154
# Stores of visitors who are fitted in a moment, for the tests of this folder. Set before: source, build, scratch; or
# `begin` sets them.

fail() { printf 'FAILED: %s\n' "$@" >&2; exit 1; }
# Of `stratalux-fit`: the quickest fit. What it finds, and what each stage survives, is others' to test.
small_options="--pool 2 --prior none --offset off --maps off --iterations 1 --layers 1"

# begin SOURCE BUILD TOOL: in a folder that goes with the test, the built programs on the path; skipped without TOOL.
begin() {
  source=$1 build=$2
  command -v "$3" >/dev/null || { echo "skipped: $3 is not installed (scripts/install-deps.sh --groups cluster)" >&2; exit 77; }
  scratch=$(mktemp -d)
  trap 'rm -rf "$scratch"' EXIT
  export PATH=$build/bin:$PATH HOME=$scratch TMPDIR=$scratch
  cd "$scratch" || fail "cd $scratch"
}

# small_store STORE VISITORS [OPTION-OF-CAPTURE]
small_store() {
  local i
  # A mono camera sees a quad with each of its pixels: a surface as fine as that of a mosaic twice as wide.
  printf 'name = "face"\n[subject]\nshape = "head"\n[camera]\ncfa = "mono"\n' >"$scratch/scene.toml"
  { printf '[camera]\nwidth = 174\nheight = 130\n'; cat "$source/tests/support/smallest_plan.toml"; } >"$scratch/rig.toml"
  for ((i = 0; i < $2; ++i)); do
    stratalux-rig capture --simulate="$scratch/scene.toml" --seed 3 --config "$scratch/rig.toml" --store "$1" ${3:+"$3"} >"$scratch/log" 2>&1 ||
      { cat "$scratch/log"; fail "a capture"; }
  done
}

# Everybody of STORE has one fit, whole, and the night's log says so once.
all_fitted_once() {
  local session fits
  for session in "$1"/sessions/*; do
    fits=$(find "$session/fits" -mindepth 1 -maxdepth 1 | wc -l)
    [ "$fits" -eq 1 ] || fail "$session has $fits fits"
    done_lines=$(cat "$1"/nights/*/"$(basename "$session").jsonl" 2>/dev/null | grep -c '"event":"done"' || true)
    [ "$done_lines" -le 1 ] || fail "$session was told $done_lines times to be done"
    rows=$(stratalux-db sql --store "$1" --json "SELECT count(*) AS n FROM access_log WHERE action = 'fit' AND session_id = '$(basename "$session")'" | grep -o '[0-9]\+' | head -n 1)
    [ "$rows" -eq 1 ] || fail "$session was entered $rows times"
  done
  stratalux-db verify --deep --store "$1" >"$scratch/verify" 2>&1 || { cat "$scratch/verify"; fail "verify --deep"; }
}
