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
# only_in PLACE HEADERS WHAT: the headers (an expression) may be included by the sources that match PLACE alone.
only_in() {
  local hits
  hits=$(grep -rnE --include='*.h' --include='*.cc' "#include [<\"]($2)" shared db firmware-host fitter 2>/dev/null | grep -vE "^$1:")
  if [ -n "$hits" ]; then
    echo "$hits" | sed "s|\$|   <- $3|"
    bad=1
  fi
}
# one_adapter FOLDER HEADERS WHAT: those sources lie in FOLDER, and there is but one.
one_adapter() {
  local files
  only_in "$1/[^/]*\.cc" "$2" "$3 only in one adapter .cc of $1"
  files=$(grep -rlE --include='*.cc' "#include [<\"]($2)" "$1" 2>/dev/null)
  if [ "$(printf '%s' "$files" | grep -c .)" -gt 1 ]; then
    echo "$files" | sed "s|\$|   <- $3 in more than one adapter|"
    bad=1
  fi
}
forbid "shared" '#include "(db|firmware-host|fitter)/' 'shared includes upward'
forbid "db" '#include "(firmware-host|fitter)/' 'db includes upward'
forbid "firmware-host" '#include "fitter/' 'the controller includes the fitter'
forbid "fitter" '#include "firmware-host/' 'the fitter includes the controller'
forbid "firmware-host shared" '#include "db/segment/truth_segment\.h"' 'truth is for evaluation alone'
for folder in fitter/*/; do
  [ "$folder" = fitter/evaluation/ ] || forbid "$folder" '#include "db/segment/truth_segment\.h"' 'truth is for evaluation alone'
done

# Libraries stay where they are wrapped.
only_in 'db/(base|catalogue)/[^/]*\.cc' 'sqlite3' 'sqlite3 only in the sources of db/base and db/catalogue'
only_in 'fitter/.*' '(opencv2|ceres)/|opencv\.hpp' 'OpenCV and Ceres only in fitter'
# family PREFIX HEADERS WHAT: the sources that include them are named for it (one lists the devices, one drives them);
# what they share of its types is PREFIX_handles.h, which is theirs alone.
family() {
  only_in "$1_([a-z0-9_]*\.cc|handles\.h)" "$2" "$3 only in the sources $1_*.cc and their $1_handles.h"
  only_in "$1_[a-z0-9_]*\.cc" "$1_handles\.h" "$1_handles.h only in the sources $1_*.cc"
}
one_adapter firmware-host/gpio 'gpiod\.h' 'libgpiod'
family firmware-host/camera/v4l2 'linux/videodev2\.h|linux/v4l2' 'V4L2'
one_adapter firmware-host/camera 'libcamera/' 'libcamera'
family firmware-host/projector/kms 'xf86drm|drm/|libdrm/|drm[_a-z]*\.h' 'DRM'
one_adapter shared/http 'microhttpd\.h' 'libmicrohttpd'
one_adapter firmware-host/kiosk 'qrencode\.h' 'libqrencode'
one_adapter firmware-host/preview 'jpeglib\.h' 'libjpeg'
# Headers of db and firmware-host show the standard library, our own types and Eigen: no library's header, no library's
# type. (db/base/sqlite.h, which db alone includes, names two of SQLite's without saying what they are.)
# A program's own command line (apps/command.h) is no public header, nor is what a family's sources share.
headers() { grep -rnE --include='*.h' "$1" db firmware-host 2>/dev/null | grep -vE '/apps/command\.h:|^firmware-host/(camera/v4l2|projector/kms)_handles\.h:'; }
hits=$(headers '#include ' | grep -vE '#include (<[a-z_]+>|<Eigen/[A-Za-z]+>|"(shared|db|firmware-host)/[^"]+")')
[ -n "$hits" ] && { echo "$hits" | sed 's|$|   <- a header that shows more than the standard library, Eigen and ours|'; bad=1; }
types='sqlite3|gpiod_[a-z]|gpiod::|v4l2_[a-z]|libcamera::|drm[A-Z_]|cv::|ceres::|nlohmann::|toml::|CLI::|png_[a-z]|XXH'
hits=$(headers "$types" | sed -E 's|//.*||' | grep -E "^[^:]+:[0-9]+:(.*[^A-Za-z_])?($types)" | grep -vE '^db/base/sqlite\.h:|:#include ')
[ -n "$hits" ] && { echo "$hits" | sed 's|$|   <- a type of a library in a header|'; bad=1; }
rooms_of_sqlite='base|keys|catalogue|care|privacy'
hits=$(grep -rnE --include='*.h' --include='*.cc' '#include "db/base/sqlite\.h"' shared firmware-host fitter db 2>/dev/null |
       grep -vE "^db/($rooms_of_sqlite)/[^/]*\.cc:|^db/catalogue/[^/]*\.h:")
[ -n "$hits" ] && { echo "$hits" | sed 's|$|   <- db/base/sqlite.h only in the rooms of db that ask the index|'; bad=1; }

# one_way PARENT FOLDERS: each folder of PARENT may include only itself and those above it in the list.
one_way() {
  local parent=$1 folder later
  shift
  later=" $* "
  for folder in "$@"; do
    later=${later#" $folder"}
    # geometry may name the pixel format of a mosaic; image and geometry are otherwise independent.
    [ "$parent/$folder" = shared/geometry ] && later=${later/ image / }
    later=${later% }
    [ -z "$later" ] || forbid "$parent/$folder" "#include \"$parent/($(tr -s ' ' '|' <<<"${later# }"))/" "$parent/$folder stands above what it includes"
    later+=" "
  done
}
one_way shared base units geometry image transport pattern capture config http manual
one_way db base keys segment ledger catalogue care privacy transfer interchange apps
one_way fitter image export sensor structured_light mixture reconstruction separation motion skin photometric srd scattering render profiles session stages calibration evaluation report pipeline batch apps
hits=$(ls -d fitter/*/ 2>/dev/null | grep -vE '/(image|export|sensor|structured_light|mixture|reconstruction|separation|motion|skin|photometric|srd|scattering|render|profiles|session|stages|calibration|evaluation|report|pipeline|batch|apps)/$')
[ -n "$hits" ] && { echo "$hits" | sed 's|$|   <- a folder of fitter that has no place among the others|'; bad=1; }
hits=$(ls db/*.h db/*.cc 2>/dev/null)
[ -n "$hits" ] && { echo "$hits" | sed 's|$|   <- a file of db has a room|'; bad=1; }
exit $bad
