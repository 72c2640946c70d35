// SPDX-License-Identifier: Apache-2.0
// Segments as a forger, an older or a later program would have written them: every hash fits.
#pragma once

#include <filesystem>
#include <functional>

#include "db/segment/segment.h"

namespace stratalux::db {

// Changes each header of a whole segment, in front of its frame and in the footer, and makes all hashes anew.
void ForgeHeaders(const std::filesystem::path& file, const std::function<void(FrameHeader&)>& change);

}  // namespace stratalux::db
