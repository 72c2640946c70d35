// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <set>
#include <utility>

#include <sys/types.h>

namespace stratalux::fit {

using SeenFiles = std::set<std::pair<dev_t, ino_t>>;

// Of the regular files below a folder, as they lie on the disk: fits are further names of their artifacts' files, and
// what was `seen` before, under any name, counts no more.
[[nodiscard]] int64_t BytesBelow(const std::filesystem::path& folder, SeenFiles& seen);

}  // namespace stratalux::fit
