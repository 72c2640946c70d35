// SPDX-License-Identifier: Apache-2.0
// The frames of a crate as 16-bit images, their values as the sensor gave them. Internal to db/interchange.
#pragma once

#include <filesystem>

#include "db/catalogue/session_store.h"
#include "db/interchange/crate_frames.h"
#include "db/interchange/export.h"

namespace stratalux::db {

// 16 bits a sample whatever the depth, values unshifted.
Status WriteCrateFrame(const std::filesystem::path& file, ExportFormat format, const Image<uint16_t>& image);
// The image of the row, checked against its size, depth and pixel hash before and after decoding, so that no file makes
// more memory than its row says. kIntegrity naming the file.
[[nodiscard]] Result<Image<uint16_t>> ReadCrateFrame(const std::filesystem::path& file, const CrateFrame& frame);

// A small 8-bit picture of a frame, brightest sample white, at most 320 pixels wide.
Status WriteThumbnail(const std::filesystem::path& file, const Image<uint16_t>& image);

}  // namespace stratalux::db
