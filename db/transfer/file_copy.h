// SPDX-License-Identifier: Apache-2.0
// Files copied with their hash taken on the way, durable before they count.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "shared/base/result.h"

namespace stratalux::db {

// Which side failed decides what follows: a source that cannot be read is kNotFound or kIntegrity and the trouble of
// one session; a target that cannot be written is kFailed and the trouble of all.

// XXH3-128 of all bytes, 32 hex digits.
[[nodiscard]] Result<std::string> HashFile(const std::filesystem::path& file);
[[nodiscard]] Result<int64_t> ModifiedNs(const std::filesystem::path& file);

// Through `to`.part, synced and renamed, so that `to` is whole or absent; makes the folders of `to`. With
// `expected_hash` (may be empty) another hash is kIntegrity and `to` stays as it was. Returns the hash of what was
// read.
[[nodiscard]] Result<std::string> CopyFileHashed(const std::filesystem::path& from, const std::filesystem::path& to,
                                                 const std::string& expected_hash);

}  // namespace stratalux::db
