// SPDX-License-Identifier: Apache-2.0
// What was forgotten, and the law that it does not come back: STORE/deletions/<id>.json (a certificate, written when
// all is done), STORE/deletions/<id>.forgetting (the intent, from the first moment on) and the deletions rows of the
// index. Reindex, pull, restore and import ask here before they take a session in.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::db {

struct Deletion {
  std::string session;
  std::string certificate_json;
};

[[nodiscard]] std::filesystem::path CertificateFile(const std::filesystem::path& store, const std::string& session_id);

// What the files alone tell, for programs that have no index to ask: true once a `forget` of the session has begun.
[[nodiscard]] bool HasTombstone(const std::filesystem::path& store, const std::string& session_id);
// The certificate files, sorted by session id.
[[nodiscard]] std::vector<std::filesystem::path> ListTombstones(const std::filesystem::path& store);

// True from the moment a `forget` of the session has begun. The files decide; the index is asked where it is there, so
// that one of the two may be lost.
[[nodiscard]] Result<bool> IsForgotten(const std::filesystem::path& store, const std::string& session_id);
// kUsage naming the certificate, for programs that were told to take the session in.
Status RefuseForgotten(const std::filesystem::path& store, const std::string& session_id);

// The certificates, by session id, from files and index.
[[nodiscard]] Result<std::vector<Deletion>> ListDeletions(const std::filesystem::path& store);

}  // namespace stratalux::db
