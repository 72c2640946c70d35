#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The include check must name every planted violation of every kind, and pass a clean tree.
set -euo pipefail
check=$(cd "$(dirname "$0")" && pwd)/check-includes.py
tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
planted=()
fresh() {
  planted=()
  rm -rf "${tree:?}"/*
  mkdir -p "$tree"/{shared/{base,image,pattern,config,http},db/{base,segment,catalogue,care,interchange,privacy},firmware-host/{apps,gpio,camera,kiosk,preview,projector},fitter/{render,evaluation}}
}
write() { echo "$2" >>"$tree/$1"; }   # FILE LINE
plant() {                             # FILE LINE: the check must complain of this line
  write "$1" "$2"
  planted+=("$1:$(wc -l <"$tree/$1"):$2")
}
expect_all_found() {
  local log violation
  if log=$("$check" "$tree"); then echo "nothing found of: ${planted[*]}"; exit 1; fi
  for violation in "${planted[@]}"; do
    grep -qF "$violation   <- " <<<"$log" || { echo "not found: $violation"; exit 1; }
  done
  fresh
}
expect_clean() { "$check" "$tree" || { echo "a clean tree was refused"; exit 1; }; fresh; }

fresh
expect_clean

# Layers.
plant shared/base/a.h '#include "db/catalogue/session_store.h"'
plant shared/image/a.h '#include "shared/pattern/pattern.h"'
plant db/base/a.cc '#include "fitter/render/mlsss.h"'
plant firmware-host/apps/a.cc '#include "fitter/render/mlsss.h"'
plant db/segment/a.h '#include "db/catalogue/session_index.h"'
plant db/catalogue/a.cc '#include "db/privacy/forget.h"'
plant db/base/a.cc '#include "db/care/reindex.h"'
plant fitter/render/a.cc '#include "firmware-host/gpio/line_bank.h"'
plant fitter/render/a.cc '#include "fitter/evaluation/metrics.h"'
plant fitter/render/a.cc '#include "db/segment/truth_segment.h"'
plant firmware-host/apps/a.cc '#include "db/segment/truth_segment.h"'
expect_all_found
write fitter/evaluation/a.cc '#include "db/segment/truth_segment.h"'
expect_clean

# SQLite.
plant db/base/a.h '#include <sqlite3.h>'
plant db/interchange/a.cc '#include <sqlite3.h>'
plant fitter/render/a.cc '#include <sqlite3.h>'
plant firmware-host/apps/a.cc '#include "db/base/sqlite.h"'
plant db/interchange/a.h '#include "db/base/sqlite.h"'
plant db/privacy/a.h '#include "db/base/sqlite.h"'
plant db/privacy/a.cc '#include <sqlite3.h>'
expect_all_found
write db/base/a.cc '#include <sqlite3.h>'
write db/base/sqlite.h 'struct sqlite3;'
write db/catalogue/session_index.h '#include "db/base/sqlite.h"'
write db/privacy/a.cc '#include "db/base/sqlite.h"'
expect_clean

# OpenCV and Ceres.
for header in '<opencv2/core.hpp>' '<ceres/ceres.h>'; do
  for file in firmware-host/apps/a.cc db/base/a.cc shared/image/a.cc; do plant "$file" "#include $header"; done
done
expect_all_found
write fitter/render/a.cc '#include <opencv2/core.hpp>'
write fitter/render/a.h '#include <ceres/ceres.h>'
expect_clean

# Devices: each library in the adapter of its folder, of one source or of those that are named for it.
adapters=(gpio '<gpiod.h>' gpio '<gpiod.hpp>' camera '<linux/videodev2.h>' camera '<libcamera/camera.h>'
          projector '<xf86drm.h>' projector '<xf86drmMode.h>' projector '<drm/drm.h>' projector '<drm_fourcc.h>' kiosk '<qrencode.h>' preview '<jpeglib.h>')
for ((i = 0; i < ${#adapters[@]}; i += 2)); do
  for file in "firmware-host/${adapters[i]}/adapter.h" firmware-host/apps/a.cc shared/base/a.cc db/base/a.cc fitter/render/a.cc; do
    plant "$file" "#include ${adapters[i + 1]}"
  done
done
expect_all_found
for adapter in 'gpio/gpiod_lines.cc <gpiod.h>' 'camera/v4l2_source.cc <linux/videodev2.h>' \
               'camera/v4l2_list.cc <linux/videodev2.h>' 'camera/libcamera_source.cc <libcamera/camera.h>' \
               'projector/kms_projector.cc <xf86drmMode.h>' 'projector/kms_list.cc <xf86drm.h>' \
               'projector/kms_handles.h <xf86drmMode.h>' 'projector/kms_card.cc "firmware-host/projector/kms_handles.h"'; do
  read -r file header <<<"$adapter"
  write "firmware-host/$file" "#include $header"
  write "firmware-host/${file%.cc}.h" '#include "shared/base/result.h"'
done
expect_clean
for name in camera/list.cc camera/my_v4l2_list.cc; do plant "firmware-host/$name" '#include <linux/videodev2.h>'; done
for name in projector/list.cc projector/my_kms_list.cc projector/my_handles.h; do plant "firmware-host/$name" '#include <xf86drm.h>'; done
for name in projector/kms_list.h projector/list.cc gpio/kms_list.cc; do plant "firmware-host/$name" '#include "firmware-host/projector/kms_handles.h"'; done
expect_all_found
adapters=(gpio '<gpiod.h>' gpio '<gpiod.hpp>' camera '<libcamera/camera.h>')
for ((i = 0; i < ${#adapters[@]}; i += 2)); do
  for name in one two; do write "firmware-host/${adapters[i]}/$name.cc" "#include ${adapters[i + 1]}"; done
  log=$("$check" "$tree") && { echo "not found: ${adapters[i + 1]} in two adapters"; exit 1; }
  grep -q "two\.cc   <- .* more than one adapter" <<<"$log" || { echo "two adapters are not named"; exit 1; }
  fresh
done

# The HTTP server's library.
for file in shared/http/server.h shared/base/a.cc db/base/a.cc firmware-host/apps/a.cc; do plant "$file" '#include <microhttpd.h>'; done
expect_all_found
write shared/http/microhttpd_server.cc '#include <microhttpd.h>'
expect_clean
for name in one two; do write "shared/http/$name.cc" '#include <microhttpd.h>'; done
log=$("$check" "$tree") && { echo "not found: microhttpd in two adapters"; exit 1; }
grep -q "two\.cc   <- .* more than one adapter" <<<"$log" || { echo "two HTTP adapters are not named"; exit 1; }
fresh
plant shared/config/a.h '#include "shared/http/server.h"'
expect_all_found

# Headers of db and firmware-host.
for file in db/base/a.h firmware-host/gpio/gpiod_a.h; do
  for header in '<nlohmann/json.hpp>' '<CLI/CLI.hpp>' '<png.h>' '<fcntl.h>' '<toml++/toml.h>' '"json.hpp"'; do
    plant "$file" "#include $header"
  done
  for type in 'struct gpiod_chip;' 'nlohmann::json parsed;' 'cv::Mat image;' 'struct v4l2_buffer;' 'struct sqlite3;' \
              'drmModeRes* mode;' 'libcamera::Camera* camera;' '  toml::table* table;'; do
    plant "$file" "$type"
  done
done
expect_all_found
for folder in db/base firmware-host/gpio; do
  write "$folder/gpiod_a.h" '#include <Eigen/Core>'
  write "$folder/gpiod_a.h" '#include "shared/base/result.h"'
  write "$folder/gpiod_a.h" '// No sqlite3 type appears here; gpiod_chip neither.'
  write "$folder/a.cc" '#include <nlohmann/json.hpp>'
done
expect_clean
