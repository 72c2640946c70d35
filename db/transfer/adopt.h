// SPDX-License-Identifier: Apache-2.0
// A session folder from elsewhere becomes a session of this store: verified, moved into place, listed.
#pragma once

#include <filesystem>
#include <set>
#include <string>

#include "db/catalogue/session_index.h"
#include "shared/base/result.h"

namespace stratalux::db {

// Every byte of a finished session's folder: manifest, each segment it names whole (and sealed, unless the session
// failed), each payload against its hash. kIntegrity names file and offset. Returns the number of frames.
[[nodiscard]] Result<int64_t> VerifyFolder(const std::filesystem::path& session_folder);

// VerifyFolder, and whether the index can take its rows: kNewerSchema for values of a later version, though their
// hashes be right. `folder` is named as the session. Whatever is wrong is the session's own trouble: never kFailed.
[[nodiscard]] Result<int64_t> CheckFolder(const std::filesystem::path& folder);

// CheckFolder, and every payload decoded and held against its pixel hash, as `verify --deep` does, on all cores. Frames
// whose key is not in `store` are held against the hash of their payload alone.
[[nodiscard]] Result<int64_t> ProveFolder(const std::filesystem::path& store,
                                          const std::filesystem::path& session_folder);

// What the next session of `index` gets: one more than any before it.
[[nodiscard]] Result<int64_t> NextNumber(SessionIndex& index);

// Moves `folder` (on the same disk, checked) to STORE/sessions/<id> and inserts its rows. Its number is the next one of
// this store: sessions of elsewhere come behind those that are here, in the order in which they are adopted; no clock
// decides. place.json keeps the number for `reindex`. kUsage for a forgotten session, and for one that is there. kBusy,
// with nothing moved, while a session is written.
Status AdoptFolder(const std::filesystem::path& store, const std::filesystem::path& folder, const std::string& from);

// The rows of a folder that an earlier adoption moved, but could not list. The same check comes first.
Status ListAdopted(const std::filesystem::path& store, const std::string& session_id, const std::string& from);

// A sealed key of a session that is here, made after it had come. kIntegrity for one that is damaged or another's;
// kUsage for a forgotten session. True where it was not here yet, or was another.
[[nodiscard]] Result<bool> AdoptSealedKey(const std::filesystem::path& store, const std::string& session_id,
                                          const std::filesystem::path& file);

// Ids of all sessions that the index lists.
[[nodiscard]] Result<std::set<std::string>> ListedSessions(const std::filesystem::path& store);

// What stops a transfer as a whole (this store cannot be written, or another program writes it); all else is the
// trouble of one session, which is named, and the others go on.
[[nodiscard]] bool IsTroubleOfAll(const Status& status);

}  // namespace stratalux::db
