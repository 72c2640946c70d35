// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/session_export.h"

#include <algorithm>
#include <optional>
#include <set>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/catalogue/fit_reader.h"
#include "db/interchange/crate_files.h"
#include "db/privacy/export_marker.h"
#include "fitter/pipeline/artifact_store.h"
#include "fitter/pipeline/interruption.h"
#include "fitter/pipeline/session_fits.h"
#include "fitter/session/choose_session.h"
#include "fitter/stages/layers.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/version.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kRecordFile = "export.json";
constexpr const char* kMaking = ".stratalux-export.partial";
constexpr const char* kLock = ".stratalux-export.lock";

struct Loaded {
  ExportedSurface surface;
  bool sealed = false;
};

Result<Loaded> LoadFrom(const StoredFit& fit) {
  Loaded loaded;
  SLX_RETURN_IF_ERROR(ReadFit(fit, [&](const fs::path& folder) -> Status {
    SLX_ASSIGN_OR_RETURN(loaded.surface, LoadFittedSurface(folder));
    return Status::Ok();
  }));
  loaded.sealed = fit.seal.active();
  loaded.surface.origin.session = fit.session;
  loaded.surface.origin.fit = fit.id;
  return loaded;
}

// The newest surface by all lights: a shape, or one that was placed. What an interrupted run has placed for a hold-out
// alone is blind to a light, and not it.
std::optional<db::ArtifactIdentity> NewestSurface(const ArtifactStore& artifacts) {
  std::set<std::string> by_all;
  for (const auto& offset : artifacts.OfStage("offset")) {
    const Json options = Json::parse(offset.identity.options_json, nullptr, false);
    if (options.is_object() && options.value("heldout", Json()) == kNoneHeldOut) by_all.insert(offset.identity.Key());
  }
  auto records = artifacts.OfStage("placed_shape");
  std::erase_if(records, [&](const db::ArtifactRecord& placed) {
    const auto offset = placed.identity.inputs.find("offset");
    return offset == placed.identity.inputs.end() || !by_all.contains(offset->second);
  });
  for (db::ArtifactRecord& shape : artifacts.OfStage("shape")) records.push_back(std::move(shape));
  const auto newest = std::ranges::max_element(records, {}, [](const auto& record) { return record.finished_wall.ns; });
  return newest == records.end() ? std::nullopt : std::optional(newest->identity);
}

// Of a session without a fit: what a run has left so far, or `reconstruct`.
Result<Loaded> LoadFromShape(const SessionExportOptions& options, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(options.store, options.session, SessionUse::kVisitor, logger));
  SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(options.store, chosen));
  const std::string session = frames.info().id;
  const Status none = Status::NotFound("session " + session + " has no fit and no surface yet: `stratalux-fit run " +
                                       session + "` makes both, `reconstruct` the surface");
  if (std::error_code error; !fs::is_directory(frames.folder() / db::kArtifactsFolder, error)) return none;
  SLX_ASSIGN_OR_RETURN(const db::FileSeal seal, db::FindSeal(frames.store(), session));
  SLX_ASSIGN_OR_RETURN(auto artifacts, ArtifactStore::Open(frames.folder(), PlainFiles(seal), logger));
  SLX_ASSIGN_OR_RETURN(const UniqueFd used, artifacts.Use());
  const auto newest = NewestSurface(artifacts);
  if (!newest) return none;
  SLX_ASSIGN_OR_RETURN(const Artifact artifact, artifacts.Read(*newest));
  Loaded loaded;
  SLX_RETURN_IF_ERROR(artifacts.ReadFiles(artifact, [&](const fs::path& folder) -> Status {
    SLX_ASSIGN_OR_RETURN(loaded.surface, LoadBareSurface(folder));
    return Status::Ok();
  }));
  loaded.sealed = seal.active();
  loaded.surface.origin.session = session;
  logger.Info("session " + session + " has no fit: the surface of its stage " + newest->stage + ", without colour");
  return loaded;
}

Result<Loaded> Load(const SessionExportOptions& options, Logger& logger) {
  if (!options.fit.empty()) {
    SLX_ASSIGN_OR_RETURN(const StoredFit fit, NamedFit(options.store, options.session, options.fit, logger));
    return LoadFrom(fit);
  }
  const auto newest = NewestFit(options.store, options.session, logger);
  if (newest.ok()) return LoadFrom(*newest);
  if (newest.status().code() != StatusCode::kNotFound) return newest.status();
  return LoadFromShape(options, logger);
}

Json RecordOf(const ExportedSurface& exported, const SurfaceExportReport& report, const Json& files) {
  Json json = {{"schema", 1}, {"program_version", kVersion}};
  for (const auto& [name, value] : exported.origin.Named()) json[name] = value;
  json["frame"] = "camera: x right, y down, z forward, mm; mesh.glb: m, y up";
  json["points"] = report.points;
  json["triangles"] = report.triangles;
  json["points_of_skin"] = report.skin;
  json["skin_told"] = exported.skin_told;
  json["points_without_albedo"] = exported.albedo.empty() ? report.points : report.without_albedo;
  json["files"] = files;
  return json;
}

void SayWhatIsMissing(const ExportedSurface& exported, const SurfaceExportReport& report, Logger& logger) {
  if (!exported.albedo.empty() && report.without_albedo > 0)
    logger.Warning(std::to_string(report.without_albedo) + " of " + std::to_string(report.points) +
                   " points were not fitted: they have the colour of the nearest one that was");
  if (report.too_far > 0)
    logger.Warning(std::to_string(report.too_far) +
                   " points lie farther behind the nearest than 16 bits reach: masked "
                   "in depth.tif (depth.exr has them)");
}

// All files and their record in `partial`; the record's text.
Result<std::string> Make(const fs::path& partial, const ExportedSurface& exported,
                         const std::set<ExportFormat>& formats, Logger& logger) {
  const auto writing = [&](const std::string& name) { logger.Info("writing " + name); };
  SLX_ASSIGN_OR_RETURN(const auto report, WriteSurface(partial, exported, formats, writing));
  SayWhatIsMissing(exported, report, logger);
  Json files = Json::array();
  for (const std::string& name : SurfaceFiles(formats)) {
    SLX_ASSIGN_OR_RETURN(const auto sum, db::ChecksumOf(partial / name));
    files.push_back({{"name", name}, {"bytes", sum.bytes}, {"sha256", sum.sha256}});
  }
  const std::string text = RecordOf(exported, report, files).dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
  SLX_RETURN_IF_ERROR(WriteText(partial / kRecordFile, text));
  SLX_RETURN_IF_ERROR(db::SyncTree(partial));
  return text;
}

// The record last, and none before: where it lies, the files are those that it names.
Status GiveNames(const fs::path& partial, const fs::path& out, const std::vector<std::string>& names) {
  const NotInterrupted whole;
  std::error_code error;
  fs::remove(out / kRecordFile, error);
  if (error) return Status::Failed("cannot replace " + (out / kRecordFile).string() + ": " + error.message());
  for (const std::string& name : names) SLX_RETURN_IF_ERROR(db::KeepFile(partial / name, out / name));
  return Status::Ok();
}

// Those that get their names, the record last; and all that may ever lie in the folder.
std::vector<std::string> NamesOf(const std::set<ExportFormat>& formats) {
  std::vector<std::string> names = SurfaceFiles(formats);
  names.emplace_back(kRecordFile);
  return names;
}
std::vector<std::string> MarkedNames(const std::vector<std::string>& names) {
  std::vector<std::string> marked = names;
  for (const std::string& name : names) marked.push_back(std::string(kMaking) + "/" + name);
  marked.emplace_back(kLock);
  return marked;
}

Result<std::string> WriteInto(const SessionExportOptions& options, const ExportedSurface& exported, Logger& logger) {
  const std::vector<std::string> names = NamesOf(options.formats);
  std::optional<RemovedOnSignal> lock_guard;  // of our own lock, never of another's
  const Result<KeyLock> lock = [&] {
    const NotInterrupted whole;
    auto tried = KeyLock::Try(options.out / kLock);
    if (tried.ok() && tried->held()) lock_guard.emplace(options.out / kLock);
    return tried;
  }();
  if (!lock.ok()) return lock.status();
  if (!lock->held()) return Status::Busy("another export writes to " + options.out.string());
  const fs::path partial = options.out / kMaking;
  const RemovedOnSignal guard(partial);
  std::error_code error;
  fs::remove_all(partial, error);
  {
    const NotInterrupted whole;
    fs::create_directory(partial, error);
  }
  if (error) return Status::Failed("cannot create " + partial.string() + ": " + error.message());
  auto record = Make(partial, exported, options.formats, logger);
  Status status = record.status();
  if (status.ok()) status = GiveNames(partial, options.out, names);
  fs::remove_all(partial, error);
  if (!status.ok()) return status;
  return record;
}

}  // namespace

Result<SessionExportOutcome> ExportSession(const SessionExportOptions& options, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const Loaded loaded, Load(options, logger));
  SessionExportOutcome outcome{loaded.surface.origin.session, loaded.surface.origin.fit, loaded.sealed, {}, {}};
  const auto write = [&]() -> Status {
    SLX_ASSIGN_OR_RETURN(outcome.record, WriteInto(options, loaded.surface, logger));
    return Status::Ok();
  };
  SLX_RETURN_IF_ERROR(db::WriteExport(options.store, "export", outcome.session, options.out,
                                      MarkedNames(NamesOf(options.formats)), write));
  for (const std::string& name : NamesOf(options.formats)) outcome.files.push_back(options.out / name);
  return outcome;
}

}  // namespace stratalux::fit
