// SPDX-License-Identifier: Apache-2.0
// What was forgotten, and the law that it does not come back: STORE/deletions/<id>.json (a certificate, written when
// all is done) and STORE/deletions/<id>.forgetting (the intent, from the first moment on). What the files alone tell,
// for those that have no index to ask; db/catalogue/deletions.h asks both.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace stratalux::db {

// True once a `forget` of the session has begun.
[[nodiscard]] bool HasTombstone(const std::filesystem::path& store, const std::string& session_id);
// The certificate files, sorted by session id.
[[nodiscard]] std::vector<std::filesystem::path> ListTombstones(const std::filesystem::path& store);

}  // namespace stratalux::db
