// SPDX-License-Identifier: Apache-2.0
#include "db/keys/session_key.h"

#include "db/keys/held_keys.h"
#include "db/keys/sealed_key.h"

namespace stratalux::db {

Result<SessionKey> FindKeyOf(const std::filesystem::path& store, const std::string& session_id, const KeyId& id) {
  auto key = FindKey(store, id);
  if (key.status().code() != StatusCode::kNotFound) return key;
  const std::string not_here = key.status().message();
  key = FindHeldKey(id);
  if (key.status().code() != StatusCode::kNotFound) return key;
  const std::filesystem::path folder = store / "sessions" / session_id;
  std::string no_copy = "no copy of it is sealed to a reader";
  if (!ListSealedKeys(folder).empty()) {
    const auto reader = ReaderKey::OfEnvironment();
    if (!reader.ok() && reader.status().code() != StatusCode::kNotFound) return reader.status();
    key = reader.ok() ? OpenSealedKey(folder, session_id, id, *reader) : Result<SessionKey>(reader.status());
    if (key.status().code() != StatusCode::kNotFound) return key;
    no_copy = reader.ok() ? "no copy of it is sealed to this reader (" + ToHex(IdOf(reader->public_key())) + ")"
                          : "there is a sealed copy, but " + reader.status().message();
  }
  return Status::NotFound(
      "session " + session_id + " is encrypted and cannot be read: " + not_here + ", and " + no_copy +
      "; it was destroyed by `forget`, or this copy was made without keys (on the machine that captured it:"
      " `stratalux-db key share` before a pull, or `stratalux-db key export` and then `key import` here)");
}

}  // namespace stratalux::db
