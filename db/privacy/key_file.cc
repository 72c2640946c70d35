// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/key_file.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sodium.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/private_leftover.h"
#include "db/base/write_lock.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/session_index.h"
#include "db/keys/key_store.h"
#include "db/privacy/export_marker.h"
#include "db/privacy/forget_intent.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;
constexpr int64_t kSchema = 1;

Result<KeyId> KeyIdFrom(const std::string& hex) {
  SLX_ASSIGN_OR_RETURN(const auto bytes, FromHex(hex));
  KeyId id{};
  if (bytes.size() != id.size()) return Status::Integrity("'" + hex + "' is not a key id");
  std::copy(bytes.begin(), bytes.end(), id.begin());
  return id;
}

Result<SessionKey> KeyFrom(const Json& json) {
  SessionKey key;
  SLX_ASSIGN_OR_RETURN(key.id, KeyIdFrom(json.at("key_id").get<std::string>()));
  SLX_ASSIGN_OR_RETURN(auto bytes, FromHex(json.at("key").get<std::string>()));
  auto secret = std::make_shared<SecretKey>();
  if (bytes.size() != secret->bytes.size()) return Status::Integrity("a key has 32 bytes");
  std::copy(bytes.begin(), bytes.end(), secret->bytes.begin());
  sodium_memzero(bytes.data(), bytes.size());
  key.key = std::move(secret);
  return key;
}

std::filesystem::path Beside(const std::filesystem::path& file) { return file.string() + ".new"; }

// What a killed export of this session left beside `file`, by the session's marker, owner and mode. kUsage for anything
// else there: whoever made that could read the key in it.
Status WipeOwnLeftover(const std::filesystem::path& file, const std::string& session_id) {
  const std::filesystem::path beside = Beside(file);
  SLX_ASSIGN_OR_RETURN(const auto left, FindPrivateLeftover(beside));
  if (left == PrivateLeftover::kNone) return Status::Ok();
  if (left == PrivateLeftover::kForeign || !IsInExport(beside, session_id))
    return Status::Usage(beside.string() + " is there, and the key would be written into it: move it away, or choose" +
                         " another name");
  return WipeFile(beside);
}

// Whole under its name or not there, and read by nobody else at any time.
Status WritePrivately(const std::filesystem::path& file, const std::string& text) {
  const std::filesystem::path beside = Beside(file);
  const UniqueFd made(open(beside.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0600));
  if (!made.ok()) return Status::Failed("cannot create " + beside.string() + ": " + std::strerror(errno));
  Status kept = WriteAll(made.get(), text.data(), text.size(), beside.string());
  if (kept.ok()) kept = KeepFile(beside, file);
  if (!kept.ok() && !WipeFile(beside).ok()) unlink(beside.c_str());
  return kept;
}

// kIntegrity where the store lists the session under another key, or none: this one would open nothing of it.
Status CheckIsKeyOf(const std::filesystem::path& store, const std::string& session, const KeyId& key) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  const auto number = index.NumberOf(session);
  if (number.status().code() == StatusCode::kNotFound) return Status::Ok();  // it comes later, by a pull
  if (!number.ok()) return number.status();
  SLX_ASSIGN_OR_RETURN(const SessionRow row, index.Session(*number));
  if (row.key_id == ToHex(key)) return Status::Ok();
  return Status::Integrity("its key " + ToHex(key) + " is not that of session " + session + ", which " +
                           (row.key_id.empty() ? "is not encrypted" : "has key " + row.key_id) +
                           "; run `stratalux-db key export` again where the session was captured");
}

}  // namespace

Status ExportKeyFile(const std::filesystem::path& store, const SessionRow& session, const std::filesystem::path& file) {
  if (session.key_id.empty()) return Status::Usage("session " + session.info.id + " is not encrypted");
  // Before it is logged; opening it asks again.
  if (std::error_code error; std::filesystem::exists(file, error))
    return Status::Usage(file.string() + " already exists; remove it first, or choose another name");
  SLX_ASSIGN_OR_RETURN(const KeyId id, KeyIdFrom(session.key_id));
  SLX_ASSIGN_OR_RETURN(const SessionKey key, FindKey(store, id));
  std::string secret(2 * key.key->bytes.size() + 1, '\0');
  sodium_bin2hex(secret.data(), secret.size(), key.key->bytes.data(), key.key->bytes.size());
  secret.pop_back();
  const Json json = {{"schema", kSchema}, {"session", session.info.id}, {"key_id", session.key_id}, {"key", secret}};
  std::error_code error;
  if (std::filesystem::exists(std::filesystem::symlink_status(file, error)))
    return Status::Usage(file.string() + " already exists; choose another name, or move it away");
  // Before the marker names it, too: `forget` would delete it.
  SLX_RETURN_IF_ERROR(WipeOwnLeftover(std::filesystem::absolute(file), session.info.id));
  const auto folder = std::filesystem::absolute(file).parent_path();
  return WriteExport(store, "key export", session.info.id, folder,
                     {file.filename().string(), Beside(file).filename().string()},
                     [&] { return WritePrivately(std::filesystem::absolute(file), json.dump(1) + "\n"); });
}

Result<std::string> ImportKeyFile(const std::filesystem::path& store, const std::filesystem::path& file) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  std::string session;
  SessionKey key;
  try {
    const Json json = Json::parse(text);
    const auto schema = WholeAt<int64_t>(json, "schema");
    if (schema < 1 || schema > kSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + std::to_string(schema) +
                                                  " is newer than this program's; use a newer stratalux");
    json.at("session").get_to(session);
    SLX_ASSIGN_OR_RETURN(key, KeyFrom(json).WithContext(file.string()));
  } catch (const nlohmann::json::exception&) {
    return Status::Integrity(file.string() + " is not a key file of `stratalux-db key export`");
  }
  SLX_RETURN_IF_ERROR(SessionStore::Open(store, AccessMode::kReadOnly).status());
  // Under the lock, which a forgetting takes as well: behind it nobody would look for the key again.
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store));
  SLX_RETURN_IF_ERROR(RefuseForgotten(store, session));
  SLX_RETURN_IF_ERROR(CheckIsKeyOf(store, session, key.id).WithContext(file.string()));
  SLX_RETURN_IF_ERROR(ImportKey(store, key).WithContext(file.string()));
  return session;
}

}  // namespace stratalux::db
