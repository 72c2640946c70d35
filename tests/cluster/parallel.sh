#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# docs/examples/night.parallel.sh as it is handed out, on a store of three visitors, in folders with a space.   parallel.sh SOURCE BUILD
set -euo pipefail
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/night-lib.sh"
begin "$1" "$2" parallel
small_store "a store" 3
mkdir "$HOME/.parallel" && touch "$HOME/.parallel/will-cite"
STRATALUX_FIT_OPTIONS=$small_options "$source/docs/examples/night.parallel.sh" "a store" "its results" 2 --jobs 2 >said 2>&1 || { cat said; fail "night.parallel.sh"; }
grep -q "^3 fits entered\|3 fits entered" said || { cat said; fail "not all three were entered"; }
all_fitted_once "a store"
