// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/forget_intent.h"

#include <algorithm>
#include <cstring>
#include <optional>

#include <nlohmann/json.hpp>
#include <sodium.h>

#include "db/base/durable_file.h"
#include "db/base/listing.h"
#include "db/care/incoming.h"
#include "db/catalogue/deletions.h"
#include "db/keys/rig_key.h"
#include "db/privacy/forget.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
constexpr size_t kHashBytes = sizeof(uint64_t);
constexpr const char* kIntent = ".forgetting";
constexpr const char* kWiping = ".wiping";
constexpr const char* kIsPlace = "instr(detail, ':/') > 0";  // what the access log says of an export

// As far as the segment can be read. Returns how many records it has.
int64_t AddHashesOf(const fs::path& segment, std::vector<uint64_t>& hashes) {
  const auto reader = SegmentReader::Open(segment);
  if (!reader.ok()) return 0;
  bool sealed = false;
  const auto records = reader->Walk(false, &sealed);
  if (!records.ok()) return 0;
  for (const SegmentFrame& record : *records) hashes.push_back(WordOf(record.header.payload_hash));
  return static_cast<int64_t>(records->size());
}

void MeasureFolder(const fs::path& folder, ForgetIntent& intent) {
  const Result<std::vector<fs::path>> files = FilesUnder(folder);
  if (!files.ok()) return;  // said by who removes it
  for (const fs::path& file : *files) {
    std::error_code error;
    if (!fs::is_regular_file(file, error)) continue;
    ++intent.files;
    const auto bytes = fs::file_size(file, error);
    if (!error) intent.bytes += static_cast<int64_t>(bytes);
  }
}

Status CollectHashes(Connection& connection, int64_t number, std::vector<uint64_t>& hashes) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT hash FROM frames WHERE session = ?1"));
  select.Bind(1, number);
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    const auto hash = select.Blob(0);
    if (hash.size() >= kHashBytes) hashes.push_back(WordOf(hash));
  }
}

Status CollectExports(Connection& connection, ForgetIntent& intent) {
  // A folder behind those within it, so that it goes when it is empty.
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare(std::string("SELECT DISTINCT detail FROM access_log WHERE ") +
                                                       kIsPlace + " AND session_id = ?1 ORDER BY detail DESC"));
  select.Bind(1, intent.session);
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    intent.exports.push_back(select.Text(0));
  }
}

Result<ForgetIntent> Collect(SessionIndex& index, const fs::path& store, const std::string& id, int64_t number,
                             IntentHashes hashes) {
  ForgetIntent intent;
  intent.session = id;
  intent.began = WallNow();
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(auto select,
                       connection.Prepare("SELECT visitor, lower(hex(key_id)), frame_count,"
                                          " (SELECT count(*) FROM fits WHERE session = number) FROM sessions"
                                          " WHERE number = ?1"));
  SLX_RETURN_IF_ERROR(select.Bind(1, number).Step().status());
  intent.visitor = select.Text(0);
  intent.key_id = select.Text(1);
  intent.frames = select.Integer(2);
  intent.fits = select.Integer(3);
  const bool wanted = hashes == IntentHashes::kCollected;
  if (wanted) SLX_RETURN_IF_ERROR(CollectHashes(connection, number, intent.hashes));
  // The index knows the frames; truth maps are known by their segment alone. Without encryption two simulations of one
  // seed share their truth: only a sealed payload is a session's own.
  if (wanted && !intent.key_id.empty()) AddHashesOf(store / "sessions" / id / "truth.seg", intent.hashes);
  SLX_RETURN_IF_ERROR(CollectExports(connection, intent));
  MeasureFolder(store / "sessions" / id, intent);
  return intent;
}

// Its files are all there is to know. The visitor stays out: they may have come again since.
ForgetIntent CollectReturned(const fs::path& store, const std::string& id) {
  ForgetIntent intent;
  intent.session = id;
  intent.began = WallNow();
  for (const fs::path& folder : {store / "sessions" / id, IncomingFolder(store, id), IncomingFits(store, id)}) {
    MeasureFolder(folder, intent);
    const Result<std::vector<fs::path>> files = EntriesOf(folder);
    if (!files.ok()) continue;
    for (const fs::path& file : *files) {
      if (file.extension() == ".seg" && file.filename() != "truth.seg")
        intent.frames += AddHashesOf(file, intent.hashes);
    }
  }
  return intent;
}

Result<ForgetIntent> IntentFrom(const Json& json) {
  ForgetIntent intent;
  json.at("session").get_to(intent.session);
  json.at("visitor").get_to(intent.visitor);
  json.at("reason").get_to(intent.reason);
  json.at("key_id").get_to(intent.key_id);
  intent.began.ns = WholeAt<int64_t>(json, "began_wall_ns");
  json.at("frames").get_to(intent.frames);
  json.at("fits").get_to(intent.fits);
  json.at("files").get_to(intent.files);
  json.at("bytes").get_to(intent.bytes);
  for (const Json& text : json.at("hashes")) {
    SLX_ASSIGN_OR_RETURN(const auto bytes, FromHex(text.get<std::string>()));
    if (bytes.size() < kHashBytes) return Status::Integrity("hash " + text.dump() + " is too short");
    intent.hashes.push_back(WordOf(bytes));
  }
  json.at("exports").get_to(intent.exports);
  return intent;
}

// nullopt for a damaged one, and for another session's.
std::optional<ForgetIntent> IntentOf(const std::string& text, const std::string& id) {
  try {
    auto intent = IntentFrom(Json::parse(text));
    if (!intent.ok() || intent->session != id) return std::nullopt;
    return std::move(*intent);
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;
  }
}

}  // namespace

ForgottenSession SessionOf(const ForgetIntent& intent) {
  ForgottenSession session;
  session.id = intent.session;
  session.frames = intent.frames;
  session.fits = intent.fits;
  session.files = intent.files;
  session.bytes = intent.bytes;
  session.encrypted = !intent.key_id.empty();
  return session;
}

uint64_t WordOf(std::span<const uint8_t> bytes) {
  uint64_t word = 0;
  std::memcpy(&word, bytes.data(), sizeof word);
  return word;
}

std::array<uint8_t, sizeof(uint64_t)> BytesOf(uint64_t hash) {
  std::array<uint8_t, sizeof hash> bytes{};
  std::memcpy(bytes.data(), &hash, sizeof hash);
  return bytes;
}

Result<std::vector<uint8_t>> FromHex(const std::string& text) {
  std::vector<uint8_t> bytes(text.size() / 2);
  size_t length = 0;
  if (text.size() % 2 != 0 ||
      sodium_hex2bin(bytes.data(), bytes.size(), text.data(), text.size(), nullptr, &length, nullptr) != 0 ||
      length != bytes.size())
    return Status::Integrity("'" + text + "' is not a hexadecimal number");
  return bytes;
}

Result<std::vector<ForgetIntent>> CollectIntents(SessionIndex& index, const fs::path& store,
                                                 const std::vector<std::string>& ids, IntentHashes hashes) {
  std::vector<ForgetIntent> intents;
  for (const std::string& id : ids) {
    const auto number = index.NumberOf(id);
    if (!number.ok()) {
      SLX_ASSIGN_OR_RETURN(const bool returned, HasReturned(store, id));
      if (!returned) return number.status();
      intents.push_back(CollectReturned(store, id));
      continue;
    }
    SLX_ASSIGN_OR_RETURN(auto intent, Collect(index, store, id, *number, hashes));
    intents.push_back(std::move(intent));
  }
  return intents;
}

Result<bool> HasReturned(const fs::path& store, const std::string& session_id) {
  std::error_code error;
  for (const fs::path& folder :
       {store / "sessions" / session_id, IncomingFolder(store, session_id), IncomingFits(store, session_id)})
    if (fs::exists(folder, error)) return IsForgotten(store, session_id);
  return false;
}

Status VisitExports(Connection& connection,
                    const std::function<void(const std::string& session, const std::string& place)>& visit) {
  SLX_ASSIGN_OR_RETURN(
      auto select,
      connection.Prepare(std::string("SELECT DISTINCT session_id, detail FROM access_log WHERE ") + kIsPlace));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    visit(select.Text(0), select.Text(1));
  }
}

fs::path IntentFile(const fs::path& store, const std::string& session_id) {
  return store / "ledger" / (session_id + kIntent);
}

Status WriteIntent(const fs::path& store, const ForgetIntent& intent) {
  Json hashes = Json::array();
  for (const uint64_t hash : intent.hashes) hashes.push_back(ToHex(BytesOf(hash)));
  SLX_RETURN_IF_ERROR(MakeFolder(IntentFile(store, intent.session).parent_path()));
  const Json json = {{"session", intent.session}, {"visitor", intent.visitor}, {"reason", intent.reason},
                     {"key_id", intent.key_id},   {"frames", intent.frames},   {"began_wall_ns", intent.began.ns},
                     {"fits", intent.fits},       {"files", intent.files},     {"bytes", intent.bytes},
                     {"hashes", hashes},          {"exports", intent.exports}};
  return ReplaceFile(IntentFile(store, intent.session),
                     json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n");
}

Status WipeIntent(const fs::path& store, const std::string& session_id) {
  const fs::path file = IntentFile(store, session_id), wiped = file.string() + kWiping;
  std::error_code error;
  fs::rename(file, wiped, error);
  if (error && error != std::errc::no_such_file_or_directory)
    return Status::Failed("cannot rename " + file.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SyncFolder(file.parent_path()));
  SLX_RETURN_IF_ERROR(WipeFile(wiped));
  return SyncFolder(file.parent_path());
}

Status TidyIntents(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(const std::vector<fs::path> files, EntriesOf(store / "ledger"));
  for (const fs::path& file : files) {
    const fs::path extension = file.extension();
    if ((extension == ".new" || extension == kWiping) && file.stem().extension() == kIntent)
      SLX_RETURN_IF_ERROR(WipeFile(file));
  }
  return Status::Ok();
}

Result<std::vector<ForgetIntent>> ReadIntents(const fs::path& store, std::vector<std::string>& unread) {
  std::vector<ForgetIntent> intents;
  SLX_ASSIGN_OR_RETURN(const std::vector<std::string> ids, UnfinishedForgets(store));
  for (const std::string& id : ids) {
    const fs::path file = IntentFile(store, id);
    const auto read = ReadFile(file);
    std::error_code unknown;
    if (!read.ok() && fs::symlink_status(file, unknown).type() == fs::file_type::not_found)
      continue;  // another forget has finished it meanwhile
    if (!read.ok()) {
      unread.push_back(read.status().message() + "; session " + id +
                       " is not completely forgotten until this account can read it: run `stratalux-db forget"
                       " --resume` as the account that began it, or change the file's owner");
      continue;
    }
    auto intent = IntentOf(*read, id);
    if (!intent) {
      unread.push_back(file.string() + " is damaged, or another session's; session " + id +
                       " is not completely forgotten: remove that file, then run `stratalux-db forget " + id +
                       "`, which collects again what is left");
      continue;
    }
    intents.push_back(std::move(*intent));
  }
  return intents;
}

Result<std::vector<std::string>> UnfinishedForgets(const fs::path& store) {
  std::vector<std::string> ids;
  SLX_ASSIGN_OR_RETURN(const std::vector<fs::path> files, EntriesOf(store / "ledger"));
  for (const fs::path& file : files)
    if (file.extension() == kIntent) ids.push_back(file.stem().string());
  return ids;
}

}  // namespace stratalux::db
