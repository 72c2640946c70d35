// SPDX-License-Identifier: Apache-2.0
#include "db/keys/session_key.h"

namespace stratalux::db {

Result<SessionKey> FindKeyOf(const std::filesystem::path& store, const std::string& session_id, const KeyId& id) {
  auto key = FindKey(store, id);
  if (key.status().code() != StatusCode::kNotFound) return key;
  return Status::NotFound(
      "session " + session_id + " is encrypted and cannot be read: " + key.status().message() +
      "; it was destroyed by `forget`, or this copy was made without keys (`stratalux-db key export`"
      " on the machine that captured it, `key import` here)");
}

}  // namespace stratalux::db
