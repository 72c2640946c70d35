// SPDX-License-Identifier: Apache-2.0
#include "db/ledger/old_tombstones.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/base/listing.h"
#include "db/ledger/ledger_folder.h"
#include "shared/base/json_nesting.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// A member of an object, where it has the type that is asked for.
int64_t IntegerOf(const Json& json, const char* key) {
  return json.is_object() && json.contains(key) && json[key].is_number_integer() ? json[key].get<int64_t>() : 0;
}

OldTombstone TombstoneOf(const fs::path& file, LedgerKind kind) {
  OldTombstone old;
  old.file = file;
  old.entry.kind = kind;
  old.entry.sessions = {file.stem().string()};
  const auto text = ReadFile(file);
  const bool sound = text.ok() && CheckNesting(*text).ok();
  const Json json = Json::parse(sound ? *text : std::string(), nullptr, false);
  old.entry.at = {IntegerOf(json, kind == LedgerKind::kForgotten ? "deleted_wall_ns" : "began_wall_ns")};
  if (kind == LedgerKind::kForgotten) {
    old.entry.detail_json = json.is_object() ? json.dump(-1, ' ', false, Json::error_handler_t::replace)
                                             : R"({"damaged": "its certificate was no JSON"})";
  } else {
    const bool has_reason = json.is_object() && json.contains("reason") && json["reason"].is_string();
    old.entry.detail_json = Json({{"reason", has_reason ? json["reason"].get<std::string>() : "forget"}}).dump();
  }
  return old;
}

Status MoveIntent(const fs::path& store, const fs::path& file) {
  const fs::path to = LedgerFolder(store) / file.filename();
  if (std::rename(file.c_str(), to.c_str()) != 0)
    return Status::Failed("cannot move " + file.string() + " to " + to.string() + ": " + std::strerror(errno));
  return SyncFolder(LedgerFolder(store));
}

bool IsStray(const fs::path& file) { return file.extension() == ".new" || file.extension() == ".wiping"; }

// What was being written or wiped when the program of then was killed holds hashes and a pseudonym.
Status EmptyFolder(const fs::path& store, const fs::path& folder) {
  std::error_code error;
  SLX_ASSIGN_OR_RETURN(const auto files, EntriesOf(folder));
  for (const fs::path& file : files) {
    const std::string extension = file.extension().string();
    if (extension == ".forgetting") {
      SLX_RETURN_IF_ERROR(MoveIntent(store, file));
    } else if (IsStray(file)) {
      SLX_RETURN_IF_ERROR(WipeFile(file));
    } else if (extension == ".json" && !fs::remove(file, error) && error) {
      return Status::Failed("cannot remove " + file.string() + ": " + error.message());
    }
  }
  SLX_RETURN_IF_ERROR(SyncFolder(folder));
  fs::remove(folder, error);  // stays where it holds what is none of ours
  return SyncFolder(store);
}

bool IsTombstone(const fs::path& file) { return file.extension() == ".json" || file.extension() == ".forgetting"; }

}  // namespace

Result<std::vector<OldTombstone>> ReadOldTombstones(const fs::path& store) {
  std::vector<OldTombstone> all;
  SLX_ASSIGN_OR_RETURN(const auto files, EntriesOf(store / "deletions"));
  for (const auto& [extension, kind] :
       {std::pair(".json", LedgerKind::kForgotten), std::pair(".forgetting", LedgerKind::kForgetting)})
    for (const fs::path& file : files)
      if (file.extension() == extension) all.push_back(TombstoneOf(file, kind));
  return all;
}

Status TakeOverOldTombstones(const fs::path& store, const TombstoneMoments& moments) {
  const fs::path folder = store / "deletions";
  std::error_code error;
  if (!fs::is_directory(folder, error)) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const auto files, EntriesOf(folder));
  if (std::none_of(files.begin(), files.end(), [](const fs::path& f) { return IsTombstone(f) || IsStray(f); })) {
    fs::remove(folder, error);  // an empty one
    return Status::Ok();
  }
  SLX_ASSIGN_OR_RETURN(const auto lock, LockLedger(store));
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::ReadFolder(LedgerFolder(store)));
  std::vector<LedgerEntry> fresh;
  SLX_ASSIGN_OR_RETURN(auto all, ReadOldTombstones(store));  // as they are under the lock
  for (OldTombstone& old : all) {
    const auto known = ledger.forgotten().find(old.entry.sessions[0]);
    const bool certified = known != ledger.forgotten().end() && !known->second.empty();
    const bool begun = known != ledger.forgotten().end();
    if (old.entry.kind == LedgerKind::kForgotten ? certified : begun) continue;
    const auto moment = moments.find(old.entry.sessions[0]);
    if (old.entry.kind == LedgerKind::kForgotten && moment != moments.end()) old.entry.at = moment->second;
    fresh.push_back(std::move(old.entry));
  }
  SLX_RETURN_IF_ERROR(AppendLocked(store, fresh));
  return EmptyFolder(store, folder);
}

}  // namespace stratalux::db
