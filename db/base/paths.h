// SPDX-License-Identifier: Apache-2.0
// Names that come from files: lists, markers, manifests.
#pragma once

#include <filesystem>

namespace stratalux::db {

// True for a relative path without `..` (and without a zero byte): joined to a folder it stays in there, as far as
// names can tell. Symbolic links are not looked at.
[[nodiscard]] bool StaysInside(const std::filesystem::path& name);
// True where `file` lies at or below `folder`, symbolic links followed.
[[nodiscard]] bool LiesIn(const std::filesystem::path& file, const std::filesystem::path& folder);

}  // namespace stratalux::db
