// SPDX-License-Identifier: Apache-2.0
// Files and names that a power cut does not take back: what is returned as kOk is on the disk. Each failure names the
// file and the operating system's reason. A failed sync is final: the caller must not sync again and go on.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "shared/base/result.h"

namespace stratalux::db {

// All `size` bytes at the descriptor's position; not yet synced. `file` is for the message.
Status WriteAll(int fd, const void* data, size_t size, const std::string& file);

// The names in `folder`: whatever was created, renamed or removed there.
Status SyncFolder(const std::filesystem::path& folder);
// `folder` and those of its parents that are missing. kOk when it is there already.
Status MakeFolder(const std::filesystem::path& folder);
// A file that is there whole, with its new bytes or its old ones: written beside, synced, renamed, its folder synced.
Status ReplaceFile(const std::filesystem::path& file, const std::string& bytes);
// The same for a file that others have written to `beside`: synced, renamed to `file`, its folder synced.
Status KeepFile(const std::filesystem::path& beside, const std::filesystem::path& file);
// The first `size` bytes stay. Never follows a symbolic link.
Status CutFile(const std::filesystem::path& file, int64_t size);
// Overwrites with zeros, syncs, removes; kOk where there is no such file. A flash disk may keep the old blocks
// (docs/privacy.md).
Status WipeFile(const std::filesystem::path& file);
// What others have written to `file`; kOk where there is none.
Status SyncFile(const std::filesystem::path& file);
// Every file and folder at and below `folder`; symbolic links are left alone.
Status SyncTree(const std::filesystem::path& folder);

}  // namespace stratalux::db
