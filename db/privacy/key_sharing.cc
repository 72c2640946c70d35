// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/key_sharing.h"

#include <algorithm>
#include <map>

#include "db/base/write_lock.h"
#include "db/catalogue/session_store.h"
#include "db/keys/readers.h"
#include "db/keys/rig_key.h"
#include "db/keys/sealed_key.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

// So many sessions under the lock at a time: a visitor who comes meanwhile waits for a moment only.
constexpr size_t kSessionsAtATime = 64;

std::vector<SessionSummary> Encrypted(std::vector<SessionSummary> sessions) {
  std::erase_if(sessions, [](const SessionSummary& session) { return session.key_id.empty(); });
  return sessions;
}

class Sharing {
 public:
  Sharing(fs::path store, std::vector<ReaderPublicKey> readers, SharedKeys& shared)
      : store_(std::move(store)), readers_(std::move(readers)), shared_(shared) {}

  Status Seal(const SessionSummary& session) {
    const std::string& id = session.info.id;
    const fs::path folder = store_ / "sessions" / id;
    std::error_code error;
    if (!fs::exists(folder, error)) return Status::Ok();  // forgotten meanwhile, or never begun
    KeyId key_id{};
    SLX_RETURN_IF_ERROR(FromHex(session.key_id, key_id).WithContext("session " + id + ": id of its key"));
    const auto key = FindKey(store_, key_id);
    if (key.status().code() == StatusCode::kNotFound) {
      shared_.not_sealed.push_back("session " + id + ": " + key.status().message());
      return Status::Ok();
    }
    SLX_RETURN_IF_ERROR(key.status());
    for (const ReaderPublicKey& reader : readers_) {
      if (CheckSealedKey(SealedKeyFile(folder, IdOf(reader)), id, key_id).ok()) continue;
      SLX_RETURN_IF_ERROR(WriteSealedKey(folder, id, *key, reader));
      ++shared_.sealed;
    }
    return Status::Ok();
  }

 private:
  const fs::path store_;
  const std::vector<ReaderPublicKey> readers_;
  SharedKeys& shared_;
};

}  // namespace

Result<SharedKeys> ShareKeys(const fs::path& store_folder, const std::optional<ReaderPublicKey>& reader) {
  SLX_ASSIGN_OR_RETURN(const auto store, SessionStore::Open(store_folder, AccessMode::kReadOnly));
  std::vector<ReaderPublicKey> readers;
  {
    // Whoever begins a session has this lock: none begins that neither knows the reader nor is listed below.
    SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store_folder));
    if (reader) SLX_RETURN_IF_ERROR(AddReader(store_folder, *reader));
    SLX_ASSIGN_OR_RETURN(readers, ListReaders(store_folder));
  }
  if (readers.empty())
    return Status::Usage(store_folder.string() +
                         " has no reader: run `stratalux-db key share PUBLIC` with the public key of one");
  SLX_ASSIGN_OR_RETURN(auto all, store.ListSessions());
  const auto sessions = Encrypted(std::move(all));
  SharedKeys shared;
  shared.readers = static_cast<int64_t>(readers.size());
  shared.sessions = static_cast<int64_t>(sessions.size());
  Sharing sharing(store_folder, readers, shared);
  for (size_t first = 0; first < sessions.size(); first += kSessionsAtATime) {
    const auto lock = WriteLock::Take(store_folder);
    if (!lock.ok())
      return lock.status().WithContext(std::to_string(first) + " of " + std::to_string(sessions.size()) +
                                       " sessions are done, and new ones are sealed as they begin; run again, `key"
                                       " share` continues");
    for (size_t i = first; i < std::min(first + kSessionsAtATime, sessions.size()); ++i)
      SLX_RETURN_IF_ERROR(sharing.Seal(sessions[i]));
  }
  return shared;
}

Result<int64_t> UnshareKeys(const fs::path& store_folder, const ReaderId& reader) {
  SLX_ASSIGN_OR_RETURN(const auto store, SessionStore::Open(store_folder, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store_folder));
  // First: nothing more is sealed to it.
  SLX_ASSIGN_OR_RETURN(const bool was_reader, RemoveReader(store_folder, reader));
  SLX_ASSIGN_OR_RETURN(const auto sessions, store.ListSessions());
  int64_t removed = 0;
  std::error_code error;
  for (const SessionSummary& session : sessions) {
    const fs::path folder = store.SessionFolder(session.info.id);
    if (fs::exists(SealedKeyFile(folder, reader), error)) ++removed;
    SLX_RETURN_IF_ERROR(WipeSealedKey(folder, reader));
  }
  if (!was_reader && removed == 0)
    return Status::NotFound(store_folder.string() + " has no reader " + ToHex(reader) +
                            ", and nothing is sealed to it");
  return removed;
}

Result<std::vector<ReaderRow>> ListSharing(const fs::path& store_folder) {
  SLX_ASSIGN_OR_RETURN(const auto store, SessionStore::Open(store_folder, AccessMode::kReadOnly));
  std::map<ReaderId, ReaderRow> rows;
  SLX_ASSIGN_OR_RETURN(const auto readers, ListReaders(store_folder));
  for (const ReaderPublicKey& reader : readers) rows[IdOf(reader)] = {IdOf(reader), reader, 0};
  SLX_ASSIGN_OR_RETURN(const auto sessions, store.ListSessions());
  for (const SessionSummary& session : sessions)
    for (const fs::path& file : ListSealedKeys(store.SessionFolder(session.info.id))) {
      const auto header = ReadSealedKeyHeader(file);
      if (!header.ok()) continue;  // `verify` names it
      ReaderRow& row = rows[header->reader];
      row.id = header->reader;
      ++row.sealed;
    }
  std::vector<ReaderRow> sharing;
  for (const auto& [id, row] : rows) sharing.push_back(row);
  return sharing;
}

Result<ReaderId> FindReader(const fs::path& store, const std::string& text) {
  if (const auto key = ParseReaderPublicKey(text); key.ok()) return IdOf(*key);
  SLX_ASSIGN_OR_RETURN(const auto rows, ListSharing(store));
  std::vector<ReaderId> found;
  for (const ReaderRow& row : rows)
    if (!text.empty() && ToHex(row.id).starts_with(text)) found.push_back(row.id);
  if (found.size() > 1)
    return Status::Usage("'" + text + "' is ambiguous: " + std::to_string(found.size()) + " readers");
  if (found.empty())
    return Status::NotFound(store.string() + " has no reader '" + text +
                            "', and nothing is sealed to one (`stratalux-db key readers` lists them)");
  return found[0];
}

}  // namespace stratalux::db
