// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_reader.h"

#include <algorithm>
#include <set>

#include <nlohmann/json.hpp>

#include "db/interchange/crate_frames.h"
#include "db/interchange/crate_metadata.h"
#include "shared/base/json_nesting.h"
#include "shared/capture/plan.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int64_t kFactsLimit = int64_t{16} << 20;    // bytes of session.json, plan.json, calibration.json
constexpr int64_t kFitJsonLimit = int64_t{64} << 20;  // of a JSON file of a fit

Status VerifyChecksums(const fs::path& crate, const CrateFiles& listed, Logger& logger) {
  Progress progress(logger, "verify", static_cast<int64_t>(listed.size()));
  for (const auto& [path, sum] : listed) {
    SLX_ASSIGN_OR_RETURN(const CrateChecksum now, ChecksumOf(crate / path));
    if (now.sha256 != sum.sha256)
      return Status::Integrity((crate / path).string() + " does not match " + kCrateManifestFile +
                               "; fetch the crate again");
    progress.Advance();
  }
  return Status::Ok();
}

// Read again, as everything of a crate is, by its own rules.
template <typename Parse>
Status ReadRecord(const fs::path& file, std::string& text, Parse parse) {
  SLX_ASSIGN_OR_RETURN(text, ReadCrateFile(file, kFactsLimit));
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  const Status status = parse(text);
  if (status.ok() || status.code() == StatusCode::kNewerSchema) return status.WithContext(file.string());
  return Status::Integrity(file.string() + ": " + status.message());
}

}  // namespace

Result<CrateReader> CrateReader::Open(const fs::path& crate, Logger& logger) {
  CrateReader reader;
  reader.crate_ = crate;
  if (std::error_code error; !fs::is_directory(crate, error))
    return Status::NotFound(crate.string() + " is not a folder; name the folder of a crate");
  SLX_RETURN_IF_ERROR(reader.ReadFormat());
  SLX_ASSIGN_OR_RETURN(const CrateFiles present, ListCrateFiles(crate));
  SLX_ASSIGN_OR_RETURN(reader.files_, ReadCrateManifest(crate, present));
  SLX_RETURN_IF_ERROR(VerifyChecksums(crate, reader.files_, logger));
  SLX_RETURN_IF_ERROR(CheckCrateMetadata(crate / kCrateMetadataFile, reader.files_));
  return reader;
}

// First of all: a later version may keep its checksums elsewhere.
Status CrateReader::ReadFormat() {
  const fs::path file = crate_ / kCrateFormatFile;
  auto text = ReadCrateFile(file, kFactsLimit);
  if (text.status().code() == StatusCode::kNotFound)
    return Status::NotFound(crate_.string() + " has no " + kCrateFormatFile +
                            ": not a crate that `stratalux-db export --crate` wrote");
  if (!text.ok()) return text.status();
  SLX_RETURN_IF_ERROR(CheckNesting(*text).WithContext(file.string()));
  try {
    const Json json = Json::parse(*text);
    if (json.at("format") != "stratalux-crate") return Status::Integrity(file.string() + ": not a Stratalux crate");
    const Json& version = json.at("version");
    if (!version.is_number_unsigned() || version == 0)
      return Status::Integrity(file.string() + ": version " + version.dump() + " does not exist");
    if (version.get<uint64_t>() > kCrateFormatVersion)
      return Status(StatusCode::kNewerSchema, file.string() + ": version " + version.dump() +
                                                  " is newer than this program (" +
                                                  std::to_string(kCrateFormatVersion) + "); update it");
    json.at("sessions").get_to(sessions_);
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
  std::set<std::string> once;
  for (const std::string& id : sessions_)
    if (!IsSessionId(id) || !once.insert(id).second)
      return Status::Integrity(file.string() + ": '" + id.substr(0, 80) + "' is not a session id, or is listed twice");
  return Status::Ok();
}

fs::path CrateReader::SessionFolder(const std::string& id) const { return crate_ / "sessions" / id; }

Result<CrateSession> CrateReader::ReadSession(const std::string& id) const {
  const fs::path folder = SessionFolder(id), facts = folder / "session.json";
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadCrateFile(facts, kFactsLimit));
  SLX_ASSIGN_OR_RETURN(CrateSession session, ParseCrateSession(text, facts.string()));
  if (session.info.id != id) return Status::Integrity(facts.string() + " is of session " + session.info.id);
  if (session.has_plan)
    SLX_RETURN_IF_ERROR(ReadRecord(folder / "plan.json", session.info.plan_json,
                                   [](const std::string& plan) { return PlanOptionsFromJson(plan).status(); }));
  if (session.has_calibration)
    SLX_RETURN_IF_ERROR(
        ReadRecord(folder / "calibration/calibration.json", session.info.calibration_json,
                   [](const std::string& record) { return RigCalibration::FromJson(record).status(); }));
  SLX_RETURN_IF_ERROR(CheckTable(id, session.frames));
  for (const std::string& file : FitFilesOf(id)) {
    if (!file.ends_with(".json")) continue;
    SLX_ASSIGN_OR_RETURN(const std::string json, ReadCrateFile(folder / "fits" / file, kFitJsonLimit));
    SLX_RETURN_IF_ERROR(CheckNesting(json).WithContext((folder / "fits" / file).string()));
  }
  return session;
}

Status CrateReader::CheckTable(const std::string& id, int64_t frames) const {
  const fs::path table = SessionFolder(id) / "frames.csv";
  SLX_ASSIGN_OR_RETURN(auto reader, CrateFrameReader::Open(table));
  CrateFrame frame;
  std::set<std::string> files;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, reader.Next(frame));
    if (!more) break;
    if (!files_.contains("sessions/" + id + "/" + frame.file))
      return Status::Integrity(table.string() + ": " + frame.file + " is not in the crate");
    if (!files.insert(frame.file).second)
      return Status::Integrity(table.string() + ": " + frame.file + " shows two frames");
  }
  if (static_cast<int64_t>(files.size()) != frames)
    return Status::Integrity(table.string() + " has " + std::to_string(files.size()) + " frames, session.json says " +
                             std::to_string(frames));
  const std::string prefix = "sessions/" + id + "/frames/";
  for (auto file = files_.lower_bound(prefix); file != files_.end() && file->first.starts_with(prefix); ++file)
    if (!files.contains("frames/" + file->first.substr(prefix.size())))
      return Status::Integrity((crate_ / file->first).string() + " is not in frames.csv");
  return Status::Ok();
}

std::vector<std::string> CrateReader::FitFilesOf(const std::string& id) const {
  const std::string prefix = "sessions/" + id + "/fits/";
  std::vector<std::string> files;
  for (auto file = files_.lower_bound(prefix); file != files_.end() && file->first.starts_with(prefix); ++file)
    files.push_back(file->first.substr(prefix.size()));
  return files;
}

}  // namespace stratalux::db
