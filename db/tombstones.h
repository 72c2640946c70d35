// SPDX-License-Identifier: Apache-2.0
// Which sessions were forgotten, as the files of STORE/deletions tell: <id>.json when all is done, <id>.forgetting from
// the first moment on. Reindex, pull and restore ask here; no index is needed.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace stratalux::db {

[[nodiscard]] bool HasTombstone(const std::filesystem::path& store, const std::string& session_id);
// The certificates, sorted by session id.
[[nodiscard]] std::vector<std::filesystem::path> ListTombstones(const std::filesystem::path& store);

}  // namespace stratalux::db
