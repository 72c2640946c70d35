// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/transcode_journal.h"

#include <algorithm>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/base/write_lock.h"
#include "db/catalogue/manifest.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

std::filesystem::path FileOf(const std::filesystem::path& store) { return store / "transcode.json"; }

// The commit moved all rows at once: those of one frame speak for all.
Status KeepIndexed(SessionIndex& index, int64_t number, const std::filesystem::path& folder,
                   const TranscodeJournal& journal) {
  SLX_ASSIGN_OR_RETURN(const auto places, index.Places(number));
  SLX_ASSIGN_OR_RETURN(const auto segments, SegmentNumbers(folder));
  const bool committed = !places.empty() && places.front().segment >= journal.first_new;
  std::vector<std::string> kept, left;
  for (const int64_t n : segments) ((n >= journal.first_new) == committed ? kept : left).push_back(SegmentName(n));
  // The manifest first: as long as it names a file, the file is there.
  if (committed) SLX_RETURN_IF_ERROR(ReplaceSegments(folder, kept));
  for (const std::string& name : left) {
    std::error_code error;
    std::filesystem::remove(folder / name, error);
    if (error) return Status::Failed("cannot remove " + (folder / name).string() + ": " + error.message());
  }
  return SyncFolder(folder);
}

}  // namespace

Result<std::vector<int64_t>> SegmentNumbers(const std::filesystem::path& folder) {
  std::vector<int64_t> numbers;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    long long number = 0;
    const std::string name = entry.path().filename().string();
    if (std::sscanf(name.c_str(), "frames-%lld.seg", &number) == 1 && name == SegmentName(number))
      numbers.push_back(number);
  }
  if (error) return Status::Failed("cannot read " + folder.string() + ": " + error.message());
  std::sort(numbers.begin(), numbers.end());
  return numbers;
}

Status WriteTranscodeJournal(const std::filesystem::path& store, const TranscodeJournal& journal) {
  const Json json = {{"schema", 1}, {"session", journal.session}, {"first_new_segment", journal.first_new}};
  return ReplaceFile(FileOf(store), json.dump(1) + "\n");
}

Result<std::optional<TranscodeJournal>> ReadTranscodeJournal(const std::filesystem::path& store) {
  const auto file = FileOf(store);
  if (std::error_code error; !std::filesystem::exists(file, error)) return std::optional<TranscodeJournal>();
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  try {
    const Json json = Json::parse(text);
    if (WholeAt<int64_t>(json, "schema") > 1)
      return Status(StatusCode::kNewerSchema, file.string() + ": written by a newer stratalux; open the store with it");
    TranscodeJournal journal;
    json.at("session").get_to(journal.session);
    journal.first_new = WholeAt<decltype(journal.first_new)>(json, "first_new_segment");
    return std::optional<TranscodeJournal>(std::move(journal));
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what() +
                             "; remove it, then `stratalux-db verify` names the segments that the index does not know");
  }
}

Status SettleTranscode(SessionIndex& index, const std::filesystem::path& store, const TranscodeJournal& journal) {
  std::error_code error;
  const auto number = index.NumberOf(journal.session);
  if (!number.ok() && number.status().code() != StatusCode::kNotFound) return number.status();
  if (number.ok()) SLX_RETURN_IF_ERROR(KeepIndexed(index, *number, store / "sessions" / journal.session, journal));
  std::filesystem::remove(FileOf(store), error);
  if (error) return Status::Failed("cannot remove " + FileOf(store).string() + ": " + error.message());
  return SyncFolder(store);
}

Status EndInterruptedTranscode(SessionIndex& index, const std::filesystem::path& store) {
  SLX_ASSIGN_OR_RETURN(const auto seen, ReadTranscodeJournal(store));
  if (!seen) return Status::Ok();
  const auto lock = WriteLock::TryTake(store);
  if (!lock.ok()) return Status::Ok();  // at work: its journal is its own
  SLX_ASSIGN_OR_RETURN(const auto journal, ReadTranscodeJournal(store));
  return journal ? SettleTranscode(index, store, *journal) : Status::Ok();
}

}  // namespace stratalux::db
