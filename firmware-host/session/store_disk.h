// SPDX-License-Identifier: Apache-2.0
// The disk of a store that may not be there yet.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>

#include "shared/base/result.h"

namespace stratalux::rig {

// The folder itself, or the nearest of those around it that is there.
[[nodiscard]] std::filesystem::path ExistingFolder(const std::filesystem::path& store);

// What a session of `frames` 12-bit mosaics may take: all of them packed and nothing saved by coding, and 64 MiB for
// index and manifests.
[[nodiscard]] int64_t SessionBytes(int64_t frames, int width, int height);
// kFailed, with both numbers and the remedy, where less than `bytes` are free for this account. A file system that
// tells no size is believed to have room.
[[nodiscard]] Status CheckFreeSpace(const std::filesystem::path& store, int64_t bytes);

// Bytes per second, written as the store does: groups of 16 frames of `frame_bytes`, then a sync. The file has no name
// that could be left over.
[[nodiscard]] Result<double> MeasureDisk(const std::filesystem::path& folder, size_t frame_bytes);

}  // namespace stratalux::rig
