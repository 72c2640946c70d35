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
#include "shared/units/time.h"

namespace stratalux::db {
namespace {

constexpr int64_t kApplicationId = 0x534c584b;  // "SLXK"
constexpr int64_t kKeySchema = 1;
constexpr const char* kSchema =
    "CREATE TABLE keys (id BLOB PRIMARY KEY, key BLOB NOT NULL, created_wall_ns INTEGER NOT NULL) STRICT, WITHOUT "
    "ROWID";

// The journal is kept (PERSIST) instead of unlinked, so that we can overwrite it. VACUUM's copy stays in memory.
constexpr const char* kPragmas =
    "PRAGMA journal_mode = PERSIST; PRAGMA secure_delete = ON; PRAGMA synchronous = EXTRA; PRAGMA temp_store = MEMORY";

Result<Connection> Checked(const std::filesystem::path& file, Connection::Mode mode) {
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(file, mode));
  SLX_ASSIGN_OR_RETURN(const int64_t identity, connection.QueryInteger("PRAGMA application_id"));
  SLX_ASSIGN_OR_RETURN(const int64_t version, connection.QueryInteger("PRAGMA user_version"));
  if (identity != kApplicationId && !(identity == 0 && version == 0))
    return Status::Integrity(file.string() + " is no key file of a Stratalux store");
  if (version > kKeySchema)
    return Status(StatusCode::kNewerSchema,
                  file.string() + ": schema " + std::to_string(version) + " is newer than this program's 1");
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
  SLX_RETURN_IF_ERROR(connection.Execute(kSchema));
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA application_id = " + std::to_string(kApplicationId)));
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA user_version = " + std::to_string(kKeySchema)));
  SLX_RETURN_IF_ERROR(transaction.Commit());
  return connection;
}

// kNotFound where there is no file. Write access where we have it: only so can SQLite undo a half-done write.
Result<Connection> OpenToRead(const std::filesystem::path& store) {
  const auto file = KeyFile(store);
  if (access(file.c_str(), F_OK) != 0) return Status::NotFound(file.string() + " does not exist");
  if (access(file.c_str(), R_OK) != 0)
    return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno) +
                          "; only the account that runs the rig may");
  return Checked(file, access(file.c_str(), W_OK) == 0 ? Connection::Mode::kReadWrite : Connection::Mode::kReadOnly);
}

Status WipeJournal(const std::filesystem::path& store) {
  SLX_RETURN_IF_ERROR(WipeFile(KeyFile(store).string() + "-journal"));
  return SyncFolder(store);
}

Status Insert(const std::filesystem::path& store, const SessionKey& key) {
  {
    SLX_ASSIGN_OR_RETURN(auto connection, OpenToWrite(store));
    SLX_ASSIGN_OR_RETURN(
        auto insert, connection.Prepare("INSERT OR IGNORE INTO keys (id, key, created_wall_ns) VALUES (?1, ?2, ?3)"));
    insert.Bind(1, std::span<const uint8_t>(key.id)).Bind(2, std::span<const uint8_t>(key.key->bytes));
    SLX_RETURN_IF_ERROR(insert.Bind(3, WallNow().ns).Run());
  }
  return WipeJournal(store);
}

}  // namespace

SecretKey::~SecretKey() { sodium_memzero(bytes.data(), bytes.size()); }

std::string ToHex(const KeyId& id) {
  char text[2 * sizeof(KeyId) + 1];
  return sodium_bin2hex(text, sizeof text, id.data(), id.size());
}

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
  SLX_ASSIGN_OR_RETURN(auto connection, OpenToRead(store));
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT key FROM keys WHERE id = ?1"));
  select.Bind(1, std::span<const uint8_t>(id));
  SLX_ASSIGN_OR_RETURN(const bool found, select.Step());
  if (!found) return Status::NotFound(KeyFile(store).string() + " has no key " + ToHex(id));
  auto bytes = select.Blob(0);
  auto secret = std::make_shared<SecretKey>();
  if (bytes.size() != secret->bytes.size())
    return Status::Integrity(KeyFile(store).string() + ": key " + ToHex(id) + " has the wrong length");
  std::copy(bytes.begin(), bytes.end(), secret->bytes.begin());
  sodium_memzero(bytes.data(), bytes.size());
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
