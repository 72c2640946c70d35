// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/shard_manifest.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/base/listing.h"
#include "db/base/own_hash.h"
#include "db/base/paths.h"
#include "db/catalogue/artifact_record.h"
#include "db/catalogue/fit_record.h"
#include "shared/base/formatted.h"
#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int kManifestSchema = 1;
constexpr const char* kBegin = "shard-";
constexpr const char* kSessions = "sessions";
constexpr const char* kMerged = "merged";
constexpr const char* kFits = "fits/";

const char* RecordOf(const MadeFolder& made) {
  return made.place.starts_with(kFits) ? db::kFitRecordFile : db::kArtifactRecordFile;
}

bool IsPlace(const std::string& place) {
  const bool known = place.starts_with(kFits) || place.starts_with(std::string(db::kArtifactsFolder) + "/");
  return known && db::StaysInside(place) && std::count(place.begin(), place.end(), '/') == 1 && !place.ends_with("/") &&
         place.find("/.") == std::string::npos;
}

Json JsonOf(const ShardVisit& visit) {
  Json json = {{"end", Json::parse(ToJson(visit.end))}, {"made", Json::array()}};
  for (const MadeFolder& made : visit.made)
    json["made"].push_back({{"folder", made.place}, {"xxh3_128", made.record_hash}});
  return json;
}

Result<ShardVisit> ShardVisitFrom(const Json& json) {
  ShardVisit visit;
  SLX_ASSIGN_OR_RETURN(visit.end, ParseNightEvent(json.at("end").dump()));
  SLX_RETURN_IF_ERROR(CheckId(visit.end.session));
  if (!IsEnd(visit.end.kind))
    return Status::Integrity(std::string("'") + ToString(visit.end.kind) + "' does not end a visitor");
  for (const Json& one : json.at("made")) {
    visit.made.push_back({one.at("folder"), one.at("xxh3_128")});
    if (!IsPlace(visit.made.back().place))
      return Status::Integrity("'" + visit.made.back().place + "' is not a folder that a shard makes");
  }
  return visit;
}

}  // namespace

const ShardVisit* ShardManifest::Find(const std::string& session) const {
  const auto found =
      std::find_if(visits.begin(), visits.end(), [&](const ShardVisit& v) { return v.end.session == session; });
  return found == visits.end() ? nullptr : &*found;
}

void ShardManifest::Say(ShardVisit visit) {
  std::erase_if(visits, [&](const ShardVisit& v) { return v.end.session == visit.end.session; });
  visits.push_back(std::move(visit));
}

fs::path ManifestFile(const fs::path& results, const Shard& shard) {
  return results / Formatted("%s%04d-of-%04d.json", kBegin, shard.index, shard.count);
}

Result<std::vector<fs::path>> ManifestFiles(const fs::path& results) {
  SLX_ASSIGN_OR_RETURN(auto files, db::EntriesOf(results));
  std::erase_if(files, [](const fs::path& file) {
    const std::string name = file.filename().string();
    return !name.starts_with(kBegin) || !name.ends_with(".json");
  });
  return files;
}

Status WriteManifest(const fs::path& results, const ShardManifest& manifest) {
  Json json = {{"schema", kManifestSchema},
               {"plan", manifest.plan},
               {"shard", manifest.shard.index},
               {"shards", manifest.shard.count},
               {"visits", Json::array()}};
  for (const ShardVisit& visit : manifest.visits) json["visits"].push_back(JsonOf(visit));
  return db::ReplaceFile(ManifestFile(results, manifest.shard),
                         db::WithOwnHash(json.dump(1, ' ', false, Json::error_handler_t::replace)));
}

Result<ShardManifest> ReadManifest(const fs::path& file, const ShardPlan& plan) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  if (db::CheckOwnHash(text) != db::OwnHash::kRight)
    return Status::Integrity(file.string() +
                             " does not match its own hash: the shard writes it again when it next runs");
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  try {
    const Json json = Json::parse(text);
    if (const auto schema = WholeAt<int64_t>(json, "schema"); schema != kManifestSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + std::to_string(schema) +
                                                  ", this program reads " + std::to_string(kManifestSchema) +
                                                  "; use a newer stratalux");
    ShardManifest manifest{json.at("plan"), {WholeAt<int>(json, "shard"), WholeAt<int>(json, "shards")}, {}};
    if (const auto& [index, count] = manifest.shard; index < 1 || index > count)
      return Status::Integrity(Formatted("%s: no shard is %d of %d", file.c_str(), index, count));
    if (manifest.plan != plan.id) return Status::Integrity(file.string() + " was made by another plan than plan.json");
    for (const Json& one : json.at("visits")) {
      auto visit = ShardVisitFrom(one);
      SLX_RETURN_IF_ERROR(visit.status().WithContext(file.string()));
      manifest.visits.push_back(std::move(*visit));
    }
    return manifest;
  } catch (const Json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

fs::path ResultsOf(const fs::path& results, const std::string& session) { return results / kSessions / session; }

bool IsMerged(const fs::path& results, const std::string& session) {
  std::error_code error;
  return fs::exists(ResultsOf(results, session) / kMerged, error);
}

// The mark first: what lies beside it counts no more.
Status MarkMerged(const fs::path& results, const std::string& session) {
  const fs::path folder = ResultsOf(results, session);
  if (!IsMerged(results, session)) {
    SLX_RETURN_IF_ERROR(db::MakeFolder(folder));
    SLX_RETURN_IF_ERROR(db::ReplaceFile(folder / kMerged, ""));
  }
  std::error_code error;
  for (const char* made : {"fits", db::kArtifactsFolder}) {
    fs::remove_all(folder / made, error);
    if (error) return Status::Failed("cannot remove " + (folder / made).string() + ": " + error.message());
  }
  return Status::Ok();
}

Status RemoveResults(const fs::path& results, const std::string& session) {
  const fs::path folder = ResultsOf(results, session);
  std::error_code error;
  fs::remove_all(folder, error);
  return error ? Status::Failed("cannot remove " + folder.string() + ": " + error.message()) : Status::Ok();
}

Result<std::vector<MadeFolder>> ListMade(const fs::path& session_results, const std::string& fit) {
  std::vector<MadeFolder> made;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(session_results / db::kArtifactsFolder, error))
    if (!entry.path().filename().string().starts_with('.') && fs::exists(entry.path() / db::kArtifactRecordFile, error))
      made.push_back({std::string(db::kArtifactsFolder) + "/" + entry.path().filename().string(), ""});
  std::sort(made.begin(), made.end(), [](const auto& a, const auto& b) { return a.place < b.place; });
  made.push_back({kFits + fit, ""});
  for (MadeFolder& one : made) {
    SLX_ASSIGN_OR_RETURN(one.record_hash, db::HashOfFile(session_results / one.place / RecordOf(one)));
  }
  return made;
}

Status CheckRecords(const fs::path& session_results, const std::vector<MadeFolder>& made) {
  for (const MadeFolder& one : made) {
    const fs::path record = session_results / one.place / RecordOf(one);
    std::error_code error;
    const auto type = fs::status(record, error).type();
    if (type == fs::file_type::not_found) return Status::NotFound(record.string() + " is missing");
    if (type == fs::file_type::none)
      return Status::Failed("cannot look at " + record.string() + ": " + error.message());
    SLX_ASSIGN_OR_RETURN(const std::string hash, db::HashOfFile(record));
    if (hash != one.record_hash)
      return Status::Integrity(record.string() + " is not the one that its manifest describes");
  }
  return Status::Ok();
}

}  // namespace stratalux::fit
