#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The include check must find a planted violation of every kind, and pass a clean tree.
set -euo pipefail
check=$(cd "$(dirname "$0")" && pwd)/check-includes.sh
tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
fresh() { rm -rf "${tree:?}"/*; mkdir -p "$tree"/{shared/{base,image,pattern},db,firmware-host/apps,fitter/{render,evaluation}}; }
fresh
"$check" "$tree" || { echo "a clean tree was refused"; exit 1; }
plant() {   # FILE INCLUDE
  fresh
  echo "#include $2" >"$tree/$1"
  if "$check" "$tree" >/dev/null; then echo "not found: $1 includes $2"; exit 1; fi
}
plant shared/base/a.h '"db/session_store.h"'
plant shared/image/a.h '"shared/pattern/pattern.h"'
plant db/a.cc '"fitter/render/mlsss.h"'
plant db/a.h '<sqlite3.h>'
plant fitter/render/a.cc '<sqlite3.h>'
plant firmware-host/apps/a.cc '"fitter/render/mlsss.h"'
plant firmware-host/apps/a.cc '<opencv2/core.hpp>'
plant fitter/render/a.cc '"firmware-host/gpio/line_bank.h"'
plant fitter/render/a.cc '"db/truth_segment.h"'
fresh
echo '#include "db/truth_segment.h"' >"$tree/fitter/evaluation/a.cc"
"$check" "$tree" || { echo "evaluation may open the truth"; exit 1; }
