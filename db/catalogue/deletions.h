// SPDX-License-Identifier: Apache-2.0
// What was forgotten, by ledger (db/ledger/ledger.h) and index. Import, key import and pull ask here before they take
// a session in.
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

// True from the moment a `forget` of the session has begun. The ledger decides; the index is asked where it is there,
// so that one of the two may be lost.
[[nodiscard]] Result<bool> IsForgotten(const std::filesystem::path& store, const std::string& session_id);
// kUsage naming the certificate, for programs that were told to take the session in.
Status RefuseForgotten(const std::filesystem::path& store, const std::string& session_id);

// The forgotten session whose id is or starts so; empty where there is none, or more than one.
[[nodiscard]] Result<std::string> FindForgotten(const std::filesystem::path& store, const std::string& selector);

// The certificates, by session id, from ledger and index; "" or "{}" while there is none.
[[nodiscard]] Result<std::vector<Deletion>> ListDeletions(const std::filesystem::path& store);

}  // namespace stratalux::db
