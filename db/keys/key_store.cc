// SPDX-License-Identifier: Apache-2.0
#include "db/keys/key_store.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/sqlite.h"
#include "db/keys/rig_key.h"
#include "shared/units/time.h"

namespace stratalux::db {
namespace {

constexpr int64_t kApplicationId = 0x534c584b;  // "SLXK"
constexpr int64_t kKeySchema = 2;
constexpr const char* kSchema1 =
    "CREATE TABLE keys (id BLOB PRIMARY KEY, key BLOB NOT NULL, created_wall_ns INTEGER NOT NULL) STRICT, WITHOUT "
    "ROWID";
constexpr const char* kSchema2 =
    "CREATE TABLE visitor_keys (pseudonym TEXT PRIMARY KEY, key BLOB NOT NULL, created_wall_ns INTEGER NOT NULL) "
    "STRICT, WITHOUT ROWID";

// The journal is kept (PERSIST) instead of unlinked, so that we can overwrite it. VACUUM's copy stays in memory.
constexpr const char* kPragmas =
    "PRAGMA journal_mode = PERSIST; PRAGMA secure_delete = ON; PRAGMA synchronous = EXTRA; PRAGMA temp_store = MEMORY";

Result<Connection> Checked(const std::filesystem::path& file, Connection::Mode mode) {
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(file, mode));
  SLX_ASSIGN_OR_RETURN(const int64_t identity, connection.QueryInteger("PRAGMA application_id"));
  SLX_ASSIGN_OR_RETURN(const int64_t version, connection.QueryInteger("PRAGMA user_version"));
  if (identity != kApplicationId && !(identity == 0 && version == 0))
    return Status::Integrity(file.string() + " is not a key file of a Stratalux store");
  if (version > kKeySchema)
    return Status(StatusCode::kNewerSchema, file.string() + ": schema " + std::to_string(version) +
                                                " is newer than this program's " + std::to_string(kKeySchema) +
                                                "; use a newer stratalux");
  return connection;
}

Result<Connection> OpenToWrite(const std::filesystem::path& store) {
  const auto file = KeyFile(store);
  // Made by us and not by SQLite, so that the file never has any other mode.
  const int fd = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  if (fd < 0) return Status::Failed("cannot write " + file.string() + ": " + std::strerror(errno));
  const bool closed = fchmod(fd, 0600) == 0;
  close(fd);
  if (!closed) return Status::Failed("cannot make " + file.string() + " private: " + std::strerror(errno));
  SLX_ASSIGN_OR_RETURN(auto connection, Checked(file, Connection::Mode::kReadWrite));
  SLX_RETURN_IF_ERROR(connection.Execute(kPragmas));
  SLX_ASSIGN_OR_RETURN(const int64_t version, connection.QueryInteger("PRAGMA user_version"));
  if (version == kKeySchema) return connection;
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  if (version < 1) SLX_RETURN_IF_ERROR(connection.Execute(kSchema1));
  SLX_RETURN_IF_ERROR(connection.Execute(kSchema2));
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA application_id = " + std::to_string(kApplicationId)));
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA user_version = " + std::to_string(kKeySchema)));
  SLX_RETURN_IF_ERROR(transaction.Commit());
  return connection;
}

// By errno.
std::string NoAccess(const std::filesystem::path& file) {
  return "cannot read " + file.string() + ": " + std::strerror(errno) + "; only the account that runs the rig may";
}

// kNotFound where there is no file. Write access where we have it: only so can SQLite undo a half-done write.
Result<Connection> OpenToRead(const std::filesystem::path& store) {
  const auto file = KeyFile(store);
  if (access(file.c_str(), F_OK) != 0) return Status::NotFound(file.string() + " does not exist");
  if (access(file.c_str(), R_OK) != 0) return Status::Failed(NoAccess(file));
  return Checked(file, access(file.c_str(), W_OK) == 0 ? Connection::Mode::kReadWrite : Connection::Mode::kReadOnly);
}

Status WipeJournal(const std::filesystem::path& store) {
  SLX_RETURN_IF_ERROR(WipeFile(KeyFile(store).string() + "-journal"));
  return SyncFolder(store);
}

// kIntegrity where the id has other bytes, which stay.
Status Insert(const std::filesystem::path& store, const SessionKey& key) {
  bool same = false;
  {
    SLX_ASSIGN_OR_RETURN(auto connection, OpenToWrite(store));
    SLX_ASSIGN_OR_RETURN(
        auto insert, connection.Prepare("INSERT OR IGNORE INTO keys (id, key, created_wall_ns) VALUES (?1, ?2, ?3)"));
    insert.Bind(1, std::span<const uint8_t>(key.id)).Bind(2, std::span<const uint8_t>(key.key->bytes));
    SLX_RETURN_IF_ERROR(insert.Bind(3, WallNow().ns).Run());
    SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT key = ?2 FROM keys WHERE id = ?1"));
    select.Bind(1, std::span<const uint8_t>(key.id)).Bind(2, std::span<const uint8_t>(key.key->bytes));
    SLX_RETURN_IF_ERROR(select.Step().status());
    same = select.Integer(0) == 1;
  }
  SLX_RETURN_IF_ERROR(WipeJournal(store));
  if (same) return Status::Ok();
  return Status::Integrity(KeyFile(store).string() + " has another key " + ToHex(key.id) +
                           ", which stays: one of the two is damaged, or not what it says; run `stratalux-db key" +
                           " export` again where the session was captured");
}

std::string NameUnder(const SecretKey& key, const std::string& pseudonym) {
  static_assert(sizeof key.bytes == crypto_auth_hmacsha512256_KEYBYTES);
  std::array<uint8_t, crypto_auth_hmacsha512256_BYTES> name{};
  crypto_auth_hmacsha512256(name.data(), reinterpret_cast<const uint8_t*>(pseudonym.data()), pseudonym.size(),
                            key.bytes.data());
  return ToHex(name);
}

// kIntegrity for bytes that are no key; they are overwritten.
Status TakeSecret(std::vector<uint8_t> bytes, const std::filesystem::path& store, const std::string& whose,
                  SecretKey& key) {
  const bool whole = bytes.size() == key.bytes.size();
  if (whole) std::copy(bytes.begin(), bytes.end(), key.bytes.begin());
  sodium_memzero(bytes.data(), bytes.size());
  return whole ? Status::Ok() : Status::Integrity(KeyFile(store).string() + ": " + whose + " has the wrong length");
}

}  // namespace

std::string ToHex(const KeyId& id) { return ToHex(std::span<const uint8_t>(id)); }

std::filesystem::path KeyFile(const std::filesystem::path& store) { return store / "keys.sqlite"; }

Result<SessionKey> CreateKey(const std::filesystem::path& store) {
  if (sodium_init() < 0) return Status::Failed("libsodium finds no source of random numbers");
  SessionKey made;
  auto secret = std::make_shared<SecretKey>();
  randombytes_buf(secret->bytes.data(), secret->bytes.size());
  randombytes_buf(made.id.data(), made.id.size());
  made.key = std::move(secret);
  SLX_RETURN_IF_ERROR(Insert(store, made));
  return made;
}

Result<SessionKey> FindKey(const std::filesystem::path& store, const KeyId& id) {
  const auto file = KeyFile(store);
  // Who may not read the keys has none: a pull by an account, or in a unit, without them still hashes what it copies.
  if (access(file.c_str(), R_OK) != 0 && errno == EACCES) return Status::NotFound(NoAccess(file));
  SLX_ASSIGN_OR_RETURN(auto connection, OpenToRead(store));
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT key FROM keys WHERE id = ?1"));
  select.Bind(1, std::span<const uint8_t>(id));
  SLX_ASSIGN_OR_RETURN(const bool found, select.Step());
  if (!found) return Status::NotFound(KeyFile(store).string() + " has no key " + ToHex(id));
  auto secret = std::make_shared<SecretKey>();
  SLX_RETURN_IF_ERROR(TakeSecret(select.Blob(0), store, "key " + ToHex(id), *secret));
  return SessionKey{id, std::move(secret)};
}

Status ImportKey(const std::filesystem::path& store, const SessionKey& key) { return Insert(store, key); }

Status DestroyKey(const std::filesystem::path& store, const KeyId& id) {
  if (access(KeyFile(store).c_str(), F_OK) != 0) return Status::Ok();
  {
    SLX_ASSIGN_OR_RETURN(auto connection, OpenToWrite(store));
    // Overwritten first and deleted then: secure_delete clears the freed cell, VACUUM what a page has moved about.
    SLX_ASSIGN_OR_RETURN(auto overwrite, connection.Prepare("UPDATE keys SET key = zeroblob(32) WHERE id = ?1"));
    SLX_RETURN_IF_ERROR(overwrite.Bind(1, std::span<const uint8_t>(id)).Run());
    SLX_ASSIGN_OR_RETURN(auto remove, connection.Prepare("DELETE FROM keys WHERE id = ?1"));
    SLX_RETURN_IF_ERROR(remove.Bind(1, std::span<const uint8_t>(id)).Run());
    SLX_RETURN_IF_ERROR(connection.Execute("VACUUM"));
  }
  return WipeJournal(store);
}

Result<std::string> NameVisitor(const std::filesystem::path& store, const std::string& pseudonym) {
  auto known = FindVisitorName(store, pseudonym);
  if (known.status().code() != StatusCode::kNotFound) return known;
  if (sodium_init() < 0) return Status::Failed("libsodium finds no source of random numbers");
  SecretKey key;
  randombytes_buf(key.bytes.data(), key.bytes.size());
  {
    SLX_ASSIGN_OR_RETURN(auto connection, OpenToWrite(store));
    SLX_ASSIGN_OR_RETURN(
        auto insert,
        connection.Prepare("INSERT INTO visitor_keys (pseudonym, key, created_wall_ns) VALUES (?1, ?2, ?3)"));
    insert.Bind(1, pseudonym).Bind(2, std::span<const uint8_t>(key.bytes)).Bind(3, WallNow().ns);
    SLX_RETURN_IF_ERROR(insert.Run());
  }
  SLX_RETURN_IF_ERROR(WipeJournal(store));
  return NameUnder(key, pseudonym);
}

Result<std::string> FindVisitorName(const std::filesystem::path& store, const std::string& pseudonym) {
  SLX_ASSIGN_OR_RETURN(auto connection, OpenToRead(store));
  SLX_ASSIGN_OR_RETURN(const int64_t version, connection.QueryInteger("PRAGMA user_version"));
  const Status missing = Status::NotFound(KeyFile(store).string() + " has no key of this visitor");
  if (version < kKeySchema) return missing;
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT key FROM visitor_keys WHERE pseudonym = ?1"));
  select.Bind(1, pseudonym);
  SLX_ASSIGN_OR_RETURN(const bool found, select.Step());
  if (!found) return missing;
  SecretKey key;
  SLX_RETURN_IF_ERROR(TakeSecret(select.Blob(0), store, "a visitor's key", key));
  return NameUnder(key, pseudonym);
}

Status DestroyVisitorKey(const std::filesystem::path& store, const std::string& pseudonym) {
  if (access(KeyFile(store).c_str(), F_OK) != 0) return Status::Ok();
  {
    SLX_ASSIGN_OR_RETURN(auto connection, OpenToWrite(store));
    for (const char* sql : {"UPDATE visitor_keys SET key = zeroblob(32) WHERE pseudonym = ?1",
                            "DELETE FROM visitor_keys WHERE pseudonym = ?1"}) {
      SLX_ASSIGN_OR_RETURN(auto statement, connection.Prepare(sql));
      SLX_RETURN_IF_ERROR(statement.Bind(1, pseudonym).Run());
    }
    SLX_RETURN_IF_ERROR(connection.Execute("VACUUM"));
  }
  return WipeJournal(store);
}

Result<std::vector<KeyId>> ListKeys(const std::filesystem::path& store) {
  std::vector<KeyId> ids;
  auto connection = OpenToRead(store);
  if (connection.status().code() == StatusCode::kNotFound) return ids;
  if (!connection.ok()) return connection.status();
  SLX_ASSIGN_OR_RETURN(auto select, connection->Prepare("SELECT id FROM keys ORDER BY created_wall_ns"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return ids;
    const auto bytes = select.Blob(0);
    KeyId id{};
    if (bytes.size() != id.size())
      return Status::Integrity(KeyFile(store).string() + ": a key's id has the wrong length");
    std::copy(bytes.begin(), bytes.end(), id.begin());
    ids.push_back(id);
  }
}

}  // namespace stratalux::db
