// SPDX-License-Identifier: Apache-2.0
// Part of `verify --deep`: every payload of a segment, hashed, opened, decoded and held against its pixel hash.
#pragma once

#include <filesystem>
#include <vector>

#include "db/care/verify.h"
#include "db/segment/segment.h"

namespace stratalux::db {

// On all cores; each thread reads frames of its own into a buffer of its own. Frames whose key is not in `store` are
// hashed and not decoded: a note says how many.
void CheckPayloads(const std::filesystem::path& store, const SegmentReader& reader,
                   const std::vector<SegmentFrame>& frames, VerifyReport& report);

}  // namespace stratalux::db
