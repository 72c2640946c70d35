#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# docs/examples/night.smk as it is handed out, on a store of three visitors, in folders with a space.   snakemake.sh SOURCE BUILD
set -euo pipefail
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/night-lib.sh"
begin "$1" "$2" snakemake
small_store "a store" 3
# shellcheck disable=SC2086
stratalux-fit batch plan --store "a store" --out "its results" $small_options
run() {
  snakemake --snakefile "$source/docs/examples/night.smk" --cores 2 --keep-going --nocolor \
    --config store="$scratch/a store" results="$scratch/its results" shards=2 >said 2>&1 || { cat said; fail "snakemake"; }
}
run
grep -q "3 fits entered" said || { cat said; fail "not all three were entered"; }
# A shard whose mark is lost runs again, as does the merge: nothing changes.
rm "its results/done/1-of-2" "its results/done/merged"
run
grep -q "0 fits entered, 3 already there" said || { cat said; fail "a second run entered something"; }
all_fitted_once "a store"
