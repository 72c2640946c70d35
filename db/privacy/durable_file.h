// SPDX-License-Identifier: Apache-2.0
// Small files that are whole or absent after a power cut, and files that go without leaving their bytes in the file.
#pragma once

#include <filesystem>
#include <string>

#include "shared/base/result.h"

namespace stratalux::db {

// Temporary file, fsync, rename, fsync of the folder.
Status WriteFileDurably(const std::filesystem::path& file, const std::string& text);
// Makes names that came or went in `folder` last.
Status SyncFolder(const std::filesystem::path& folder);
// Overwrites with zeros, syncs, removes; kOk where there is no such file. A flash disk may keep the old blocks
// (docs/privacy.md).
Status WipeFile(const std::filesystem::path& file);

}  // namespace stratalux::db
