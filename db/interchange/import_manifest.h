// SPDX-License-Identifier: Apache-2.0
// The import manifest: a TOML file that names ordinary image files and says what each one shows (docs/file-formats.md).
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/capture/frame_record.h"
#include "shared/capture/session.h"

namespace stratalux::db {

// How 12-bit values lie in the 16-bit samples of a file.
enum class SampleAlignment { kHigh, kLow };  // value << 4 (as `frames --extract` writes) | value

struct ImportFrame {
  std::filesystem::path file;
  std::string where;   // file:line of the entry that names it
  FrameRecord record;  // width and height: as the pose says, 0 where it leaves them to the file
};

struct ImportManifest {
  SessionInfo info;  // kind, rig, visitor, devices
  int camera_width = 0, camera_height = 0;
  int bit_depth = 8;  // 8, 12 or 16: bits that a sample of the files means
  SampleAlignment alignment = SampleAlignment::kHigh;
  std::vector<ImportFrame> frames;  // pose by pose, in the order of the entries
  std::vector<std::string> notes;   // what is taken and may not be meant, for a warning
};

struct ImportOptions {
  std::filesystem::path manifest;
  std::filesystem::path root;  // folder that the files' names start from; empty: the manifest's own
  std::optional<int> pose;     // this pose only
};

// kUsage with file:line for unreadable manifests, unknown keys, wrong types, values out of range and patterns that the
// projector cannot show, whose code numbers fewer columns than it has, or that two frames of a pose show (but for white
// and black). Opens no image file.
[[nodiscard]] Result<ImportManifest> ReadImportManifest(const ImportOptions& options);

}  // namespace stratalux::db
