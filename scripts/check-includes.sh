#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Who may include whom (docs/conventions.md). Prints each violation as file:line; exit 1 if there is any.
#   scripts/check-includes.sh [ROOT]
set -uo pipefail
cd "${1:-$(dirname "$0")/..}" || exit 2
bad=0
# forbid WHERE PATTERN WHY: no file under WHERE may match the extended regular expression.
forbid() {
  local hits
  hits=$(grep -rnE --include='*.h' --include='*.cc' "$2" $1 2>/dev/null)
  if [ -n "$hits" ]; then
    echo "$hits" | sed "s|\$|   <- $3|"
    bad=1
  fi
}
forbid "shared" '#include "(db|firmware-host|fitter)/' 'shared includes upward'
forbid "db" '#include "(firmware-host|fitter)/' 'db includes upward'
forbid "firmware-host" '#include "fitter/' 'the controller includes the fitter'
forbid "fitter" '#include "firmware-host/' 'the fitter includes the controller'
forbid "shared firmware-host fitter" '#include <sqlite3\.h>' 'sqlite3 only in db/*.cc'
hits=$(grep -rnE --include='*.h' '#include <sqlite3\.h>' db 2>/dev/null) && { echo "$hits   <- sqlite3 only in db/*.cc"; bad=1; }
forbid "shared db firmware-host" '#include <(opencv2|ceres)/' 'OpenCV and Ceres only in fitter'
forbid "firmware-host shared" '#include "db/truth_segment\.h"' 'truth is for evaluation alone'
for folder in fitter/*/; do
  [ "$folder" = fitter/evaluation/ ] || forbid "$folder" '#include "db/truth_segment\.h"' 'truth is for evaluation alone'
done
# Inside shared/, each folder may include only itself and those above it in the list.
order="base units geometry image transport pattern capture config"
later="$order"
for folder in $order; do
  later=${later#"$folder"}; later=${later# }
  # geometry may name the pixel format of a mosaic; image and geometry are otherwise independent.
  for below in $later; do
    [ "$folder/$below" = geometry/image ] && continue
    forbid "shared/$folder" "#include \"shared/$below/" "shared/$folder stands above shared/$below"
  done
done
exit $bad
