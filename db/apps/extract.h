// SPDX-License-Identifier: Apache-2.0
// `stratalux-db frames --extract`: frames as PNG files.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "shared/base/log.h"

namespace stratalux::db {

// "000012-gray-columns-bit-3-10.png".
[[nodiscard]] std::string ExtractedName(const FrameRow& frame);
// One file a frame in `folder` (made when missing): 8-bit frames as 8-bit PNG, 12-bit values in the upper bits of
// 16-bit PNG (value << 4), 16-bit frames as they are. Logged, and marked for `forget` to find, before the first one is
// written. kIntegrity for damaged frames.
Status ExtractFrames(const SessionStore& store, const std::string& session_id, const std::vector<FrameRow>& frames,
                     const std::filesystem::path& folder, Logger& logger);

}  // namespace stratalux::db
