// SPDX-License-Identifier: Apache-2.0
// Files of a folder, and of nowhere else.
#pragma once

#include <filesystem>
#include <string>

#include "shared/base/result.h"
#include "shared/http/message.h"

namespace stratalux::http {

// Opens `relative` below `root` step by step: no symbolic link is followed, ".." and absolute names are none of ours
// (kNotFound for each of these, as for what is not there or is no regular file). The folders on the way to `root` may
// be links; root itself may not. kFailed where the file cannot be read.
[[nodiscard]] Result<FileBody> OpenBelow(const std::filesystem::path& root, const std::string& relative);

// The answer to whoever asks for it; 404, or 500 where the disk fails.
[[nodiscard]] Response FileOf(const std::filesystem::path& root, const std::string& relative);

// By the ending of the name; "application/octet-stream" for all that a browser needs not show.
[[nodiscard]] std::string ContentTypeOf(const std::string& name);

}  // namespace stratalux::http
