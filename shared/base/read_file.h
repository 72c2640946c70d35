// SPDX-License-Identifier: Apache-2.0
// A whole file at once.
#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>

#include "shared/base/result.h"

namespace stratalux {

// Records, manifests, lists: what people and programs write as text. None comes near it.
inline constexpr int64_t kMostRecordBytes = int64_t{64} << 20;
// Of a picture: 268 million samples of 16 bits, uncompressed.
inline constexpr int64_t kMostPictureBytes = int64_t{1} << 30;
// For what is copied, whatever its size.
inline constexpr int64_t kAnyFileSize = std::numeric_limits<int64_t>::max();

// The bytes of `file`. kNotFound where it is not there; kFailed where it cannot be opened or read (another account's, a
// broken disk), is no regular file (a folder, a device, a pipe: none of them is waited for) or holds more than
// `most_bytes`, of which then nothing is read. The message names file, size and limit, or the reason.
[[nodiscard]] Result<std::string> ReadFile(const std::filesystem::path& file, int64_t most_bytes = kMostRecordBytes);

}  // namespace stratalux
