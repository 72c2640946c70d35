// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/publish.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <stdio.h>

#include "db/base/durable_file.h"
#include "db/base/own_hash.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/fit_store.h"
#include "db/catalogue/recorded_files.h"
#include "fitter/evaluation/compare.h"
#include "fitter/image/on_quads.h"
#include "fitter/pipeline/interruption.h"
#include "fitter/report/session_report.h"
#include "fitter/stages/diffuse_normals.h"
#include "fitter/stages/offset.h"
#include "fitter/stages/separate.h"
#include "fitter/stages/srd_file.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/json_nesting.h"
#include "shared/base/read_file.h"
#include "shared/base/version.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

constexpr const char* kPartial = ".partial";
constexpr const char* kEnters = "enters this fit";
constexpr const char* kAblations[] = {"projectors_permuted", "comb_frames_shuffled"};

// Keys of the stages that a fit is made of; their files are the fit's.
std::map<std::string, std::string> StagesOf(SessionGraph& graph, const RunOptions& options) {
  std::map<std::string, std::string> keys = {{"shape", graph.PlacedShape(options.geometry, kNoneHeldOut)},
                                             {"separate", graph.Separate()},
                                             {"normals", graph.Normals()},
                                             {"skin", graph.Skin()},
                                             {"fit", graph.Fit(options.geometry, options.heldout, FitKind::kJudged)}};
  if (const std::string offset = graph.Offset(options.geometry, kNoneHeldOut); !offset.empty()) keys["offset"] = offset;
  if (options.MakesMaps()) keys["maps"] = graph.Maps();
  keys["diffuse_normals"] = graph.DiffuseNormals();
  if (options.standard_errors) keys["standard_errors"] = graph.StandardErrors();
  return keys;
}

// The file by another name; where the file system has no links, a copy.
Status Link(const fs::path& from, const fs::path& to) {
  std::error_code error;
  fs::create_hard_link(from, to, error);
  if (error) fs::copy_file(from, to, error);
  return error ? Status::Failed("cannot copy " + from.string() + " to " + to.string() + ": " + error.message())
               : Status::Ok();
}

Status LinkFiles(const fs::path& from, const fs::path& to) {
  SLX_ASSIGN_OR_RETURN(const auto names, db::NamesOfFiles(from, db::kArtifactRecordFile));
  for (const std::string& name : names) {
    SLX_RETURN_IF_ERROR(MakeFoldersBelow(to, fs::path(name).parent_path()));
    SLX_RETURN_IF_ERROR(Link(from / name, to / name));
  }
  return Status::Ok();
}

// `errors`: gets those of the hold-out.
Status AddComparison(SessionGraph& graph, const std::string& key, Metrics& metrics,
                     std::vector<LightComparison>* pictures, std::vector<HeldOutErrors>* errors) {
  SLX_ASSIGN_OR_RETURN(auto comparison, graph.stages().Load(key, LoadComparison));
  metrics.heldout.insert(metrics.heldout.end(), comparison.figures.begin(), comparison.figures.end());
  metrics.coverage.push_back(comparison.coverage);
  if (pictures != nullptr) *pictures = std::move(comparison.pictures);
  if (errors != nullptr) errors->push_back(std::move(comparison.errors));
  return Status::Ok();
}

Status AddCentroid(SessionGraph& graph, GeometrySource source, int heldout, Metrics& metrics) {
  const std::string fit = graph.Fit(source, heldout, FitKind::kJudged);
  SLX_ASSIGN_OR_RETURN(const auto summary, graph.stages().Load(fit, LoadSummary));
  metrics.centroids.push_back({heldout, ToString(source), summary.centroid});
  return Status::Ok();
}

// Of the simulation, on the rays and in the rig of its frames; nullopt of a real capture.
Result<std::optional<TrueSurface>> ReadTruth(const SessionFrames& frames, const RigCalibration& rig) {
  SLX_ASSIGN_OR_RETURN(const auto truth, SceneTruth::Open(frames.folder()));
  if (!truth) return std::optional<TrueSurface>();
  SLX_ASSIGN_OR_RETURN(auto surface, truth->SurfaceInItsRig(rig));
  return std::optional(std::move(surface));
}

Result<std::optional<SurfaceError>> AgainstTruth(SessionGraph& graph, const std::optional<TrueSurface>& truth,
                                                 const std::string& shape) {
  if (!truth) return std::optional<SurfaceError>();
  SLX_ASSIGN_OR_RETURN(const FaceShape made, graph.stages().Load(shape, LoadShape));
  return std::optional(CompareWithTruth(made.surface, made.record, *truth));
}

// Of quads of the surface that the mask was made of.
Result<SkinFigure> SkinFigureOf(const SessionFrames& frames, const SkinMask& mask) {
  SkinFigure figure{mask.surface_quads(), mask.skin_quads, mask.told, {}, {}};
  for (int r = 0; r < kSkinReasons; ++r)
    if (const auto reason = static_cast<SkinReason>(r); reason != SkinReason::kNoSurface)
      figure.surface_by_reason[ToString(reason)] = mask.counts[r];
  SLX_ASSIGN_OR_RETURN(const auto truth, SceneTruth::Open(frames.folder()));
  if (!truth) return figure;
  SLX_ASSIGN_OR_RETURN(const auto skin, truth->SkinOrStubble());
  if (skin.empty()) return figure;
  Image<uint8_t> surface(mask.reason.width(), mask.reason.height(), 1);
  for (int y = 0; y < surface.height(); ++y)
    for (int x = 0; x < surface.width(); ++x) surface(x, y) = mask.HasSurface(x, y);
  figure.truth = CompareMasks(skin, mask.skin, surface);
  return figure;
}

// Of the surface that fits without `heldout` (none: the fit's files) stand on; nothing where it was not moved.
Status AddOffset(SessionGraph& graph, const std::optional<TrueSurface>& truth, GeometrySource source,
                 std::optional<int> heldout, FitKind kind, Metrics& metrics) {
  const int projector = heldout.value_or(kNoneHeldOut);
  const std::string key = graph.Offset(source, projector, kind);
  if (key.empty()) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const auto offset, graph.stages().Load(key, LoadOffset));
  OffsetFigure figure{heldout, kind == FitKind::kJudged ? graph.JudgedModel() : "direction_blind_placed", offset.found,
                      std::nullopt};
  SLX_ASSIGN_OR_RETURN(figure.truth, AgainstTruth(graph, truth, graph.PlacedShape(source, projector, kind)));
  metrics.offsets.push_back(figure);
  return Status::Ok();
}

// The projectors that --full-evaluation holds out, and the surface that it does so on.
std::vector<std::pair<GeometrySource, int>> FullViews(const SessionGraph& graph, const RunOptions& options) {
  std::vector<std::pair<GeometrySource, int>> views;
  for (int p = 0; p < graph.projectors(); ++p)
    if (p != options.heldout) views.emplace_back(options.geometry, p);
  if (graph.has_truth() && options.geometry == GeometrySource::kReconstructed)
    views.emplace_back(GeometrySource::kTruth, options.heldout);
  return views;
}

std::string Ablations(SessionGraph& graph, const RunOptions& options) {
  std::vector<std::string> spoilt = {graph.JudgedModel()};
  spoilt.insert(spoilt.end(), std::begin(kAblations), std::end(kAblations));
  return graph.Compare(spoilt, options.geometry, options.heldout);
}

// Every projector held out in turn; ablations; and the same on the true surface: what of the error is the model's, not
// the reconstruction's.
Status EvaluateFully(SessionGraph& graph, const RunOptions& options, const std::optional<TrueSurface>& truth,
                     Metrics& metrics, std::vector<HeldOutErrors>& errors) {
  SLX_ASSIGN_OR_RETURN(const auto compared, graph.stages().Load(Ablations(graph, options), LoadComparison));
  metrics.ablations = compared.figures;
  SLX_RETURN_IF_ERROR(
      AddOffset(graph, truth, options.geometry, options.heldout, FitKind::kDirectionBlindPlaced, metrics));
  for (const auto& [source, projector] : FullViews(graph, options)) {
    const auto models = ModelsOf(graph, Evaluation::kFull, source, projector);
    SLX_RETURN_IF_ERROR(AddComparison(graph, graph.Compare(models, source, projector), metrics, nullptr,
                                      source == options.geometry ? &errors : nullptr));
    SLX_RETURN_IF_ERROR(AddCentroid(graph, source, projector, metrics));
    for (const FitKind kind : {FitKind::kJudged, FitKind::kDirectionBlindPlaced})
      SLX_RETURN_IF_ERROR(AddOffset(graph, truth, source, projector, kind, metrics));
  }
  return Status::Ok();
}

// Layers of all projectors are in memory no longer than what is shown of them takes.
Result<ShownLayers> LayersToShow(StageGraph& stages, const std::map<std::string, std::string>& keys,
                                 const FittedLayers& fit, int projectors) {
  const auto maps = keys.find("maps");
  if (maps == keys.end()) return ShownOf(fit, projectors);
  SLX_ASSIGN_OR_RETURN(const auto layers, stages.Load(maps->second, LoadMaps));
  ShownLayers shown = ShownOf(layers, projectors);
  SLX_ASSIGN_OR_RETURN(shown.of_all, stages.Load(maps->second, LoadMapsFigures));
  return shown;
}

Status NothingFitted(const SessionFrames& frames, const FitSummary& summary) {
  std::string reasons;
  for (const auto& [reason, count] : summary.masked_by_reason)
    reasons += (reasons.empty() ? "" : ", ") + reason + " " + std::to_string(count);
  return Status::Failed("session " + frames.info().id + ": no pixel could be fitted (" + reasons +
                        "): is the face in the picture, lit and in focus? (`stratalux-fit separate` shows it)");
}

std::string EvaluationKey(SessionGraph& graph, const RunOptions& options, Evaluation evaluation) {
  return db::HashHex(nlohmann::json(KeysOf(graph, options, evaluation)).dump());
}

}  // namespace

std::string LockOfFit(const std::string& fit) { return "fit-" + fit; }

Status PutInPlace(const fs::path& made, const fs::path& place) {
  std::error_code error;
  const NotInterrupted whole;
  if (!fs::exists(place, error)) {
    fs::rename(made, place, error);
  } else if (renameat2(AT_FDCWD, made.c_str(), AT_FDCWD, place.c_str(), RENAME_EXCHANGE) == 0) {
    fs::remove_all(made, error);  // the earlier one
  } else {
    return Status::Failed("cannot replace " + place.string() + ": " + std::strerror(errno));
  }
  return error ? Status::Failed("cannot move " + made.string() + ": " + error.message()) : Status::Ok();
}

const char* ToString(Evaluation evaluation) {
  switch (evaluation) {
    case Evaluation::kFirst:
      return "first";
    case Evaluation::kHeldOut:
      return "held_out";
    case Evaluation::kFull:
      return "full";
  }
  return "";
}

std::vector<std::string> ModelsOf(SessionGraph& graph, Evaluation evaluation, GeometrySource source, int heldout) {
  std::vector<std::string> models = {graph.JudgedModel(), "homogeneous"};
  if (evaluation == Evaluation::kFirst) return models;
  for (const char* name : {"homogeneous_local_albedo", "direction_blind", "dipole"}) models.emplace_back(name);
  if (evaluation == Evaluation::kFull && !graph.Offset(source, heldout).empty())
    models.emplace_back("direction_blind_placed");
  return models;
}

std::string FitIdOf(SessionGraph& graph, const RunOptions& options) {
  return db::HashHex(nlohmann::json(StagesOf(graph, options)).dump()).substr(0, 16);
}

std::vector<std::string> KeysOf(SessionGraph& graph, const RunOptions& options, Evaluation evaluation) {
  std::vector<std::string> keys = {graph.Normals(), graph.Skin(), graph.PlacedShape(options.geometry, kNoneHeldOut)};
  if (options.MakesMaps()) keys.push_back(graph.Maps());
  keys.push_back(graph.DiffuseNormals());
  if (options.standard_errors) keys.push_back(graph.StandardErrors());
  const auto compare = [&](GeometrySource source, int heldout) {
    return graph.Compare(ModelsOf(graph, evaluation, source, heldout), source, heldout);
  };
  keys.push_back(compare(options.geometry, options.heldout));
  if (evaluation != Evaluation::kFull) return keys;
  keys.push_back(Ablations(graph, options));
  for (const auto& [source, projector] : FullViews(graph, options)) keys.push_back(compare(source, projector));
  return keys;
}

Status SettleFits(SessionGraph& graph, const SessionFrames& frames, const std::string& fit) {
  const ArtifactStore& locks = graph.stages().store();
  const fs::path place = frames.store().FitFolder(frames.info().id, fit);
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(place.parent_path(), error)) {
    if (entry.path().extension() != kPartial) continue;
    SLX_ASSIGN_OR_RETURN(const KeyLock lock, locks.TryLock(LockOfFit(entry.path().stem().string())));
    if (lock.held()) fs::remove_all(entry.path(), error);
  }
  if (!fs::exists(place / db::kFitRecordFile, error)) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const KeyLock lock, locks.Lock(LockOfFit(fit), kEnters));
  SLX_ASSIGN_OR_RETURN(const db::FitRow made, db::ReadFitRecord(place, frames.info().id));
  SLX_ASSIGN_OR_RETURN(const auto rows, frames.store().ListFits(frames.info().id));
  for (const db::FitRow& row : rows)
    if (row.id == fit && row.metrics_json == made.metrics_json) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const db::FitRow proven, db::ReadProvenFit(place, frames.info().id));
  return db::RegisterFit(frames.store().folder(), proven);
}

Result<std::optional<Evaluation>> EvaluationHeld(SessionGraph& graph, const RunOptions& options,
                                                 const SessionFrames& frames, const std::string& fit) {
  std::optional<Evaluation> none;
  const fs::path folder = frames.store().FitFolder(frames.info().id, fit);
  SLX_ASSIGN_OR_RETURN(const auto fits, frames.store().ListFits(frames.info().id));
  const bool listed = std::any_of(fits.begin(), fits.end(), [&](const db::FitRow& row) { return row.id == fit; });
  std::error_code error;
  if (!listed || !fs::exists(folder / db::kFitRecordFile, error)) return none;
  SLX_RETURN_IF_ERROR(db::CheckFitFiles(folder));
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(folder / "metrics.json"));
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext((folder / "metrics.json").string()));
  const auto json = nlohmann::json::parse(text, nullptr, false);
  const std::string held = json.is_object() ? json.value("evaluation", "") : "";
  for (const Evaluation evaluation : {Evaluation::kFirst, Evaluation::kHeldOut, Evaluation::kFull}) {
    if (held != ToString(evaluation)) continue;
    const std::string today = EvaluationKey(graph, options, evaluation);
    return json.value("evaluation_key", "") == today ? std::optional(evaluation) : none;
  }
  return none;
}

Result<fs::path> Publish(SessionGraph& graph, const RunOptions& options, SessionFrames& frames, Evaluation evaluation,
                         KnownPictures& pictures) {
  StageGraph& stages = graph.stages();
  const std::map<std::string, std::string> keys = StagesOf(graph, options);
  Metrics metrics;
  SLX_ASSIGN_OR_RETURN(metrics.summary, stages.Load(keys.at("fit"), LoadSummary));
  if (metrics.summary.pixels == 0) return NothingFitted(frames, metrics.summary);

  SLX_ASSIGN_OR_RETURN(const FaceShape* shape, graph.Face(keys.at("shape")));
  SLX_ASSIGN_OR_RETURN(const auto truth, ReadTruth(frames, shape->record));
  SLX_RETURN_IF_ERROR(AddOffset(graph, truth, options.geometry, options.heldout, FitKind::kJudged, metrics));
  SLX_RETURN_IF_ERROR(AddOffset(graph, truth, options.geometry, std::nullopt, FitKind::kJudged, metrics));
  if (metrics.offsets.empty()) {
    SLX_ASSIGN_OR_RETURN(metrics.truth, AgainstTruth(graph, truth, keys.at("shape")));
  } else {
    metrics.truth = metrics.offsets.back().truth;  // by all projectors: the fit's surface
    SLX_ASSIGN_OR_RETURN(metrics.unplaced, AgainstTruth(graph, truth, graph.Shape(options.geometry)));
  }
  SLX_ASSIGN_OR_RETURN(const SkinMask skin, stages.Load(keys.at("skin"), LoadSkin));
  SLX_ASSIGN_OR_RETURN(metrics.skin, SkinFigureOf(frames, skin));
  const int projectors = static_cast<int>(shape->record.projectors.size());
  SLX_ASSIGN_OR_RETURN(const auto* separation, graph.Separation(keys.at("separate")));
  SLX_ASSIGN_OR_RETURN(const FittedLayers* layers, graph.Layers(keys.at("fit")));
  const auto load_normals = [&](const fs::path& folder) { return LoadNormals(folder, layers->map.channels); };
  SLX_ASSIGN_OR_RETURN(const auto normals, stages.Load(keys.at("normals"), load_normals));
  const auto load_diffuse = [&](const fs::path& folder) { return LoadDiffuseNormals(folder, layers->map.channels); };
  SLX_ASSIGN_OR_RETURN(const auto diffuse, stages.Load(keys.at("diffuse_normals"), load_diffuse));
  if (truth) {
    SLX_ASSIGN_OR_RETURN(const auto width_mm, graph.ShownWidths());
    const SurfaceMap& surface = shape->surface;
    metrics.normals = CompareNormalsWithTruth({normals.fused, surface.normal, normals.photometric.normal, diffuse,
                                               OnQuads(width_mm, options.srd.pool, surface.width(), surface.height())},
                                              *truth);
  }
  SLX_ASSIGN_OR_RETURN(auto shown, LayersToShow(stages, keys, *layers, projectors));
  const int64_t chosen = ProfileToShow(layers->map);
  const auto load_profile = [&](const fs::path& folder) { return LoadProfileSrds(folder, chosen); };
  SLX_ASSIGN_OR_RETURN(auto srds, stages.Load(graph.Srd(options.geometry), load_profile));
  metrics.sweeps = std::move(srds.figures);
  const std::string offset_key = graph.Offset(options.geometry, options.heldout);
  if (!offset_key.empty() && chosen >= 0) {
    SLX_ASSIGN_OR_RETURN(const auto offset, stages.Load(offset_key, LoadOffset));
    const auto pixel = chosen / layers->map.channels;
    const float deeper = offset.DeeperMm(static_cast<int>(pixel % layers->map.width),
                                         static_cast<int>(pixel / layers->map.width), layers->pool);
    for (SrdBatch& batch : srds.batches) MoveSurface(batch, 1, {&deeper, 1}, 1.0);
  }
  ReportInput input{frames, *shape,         *separation,      normals, diffuse,
                    skin,   *layers,        std::move(shown), chosen,  std::move(srds.batches),
                    {},     options.heldout};
  const std::string compare =
      graph.Compare(ModelsOf(graph, evaluation, options.geometry, options.heldout), options.geometry, options.heldout);
  std::vector<HeldOutErrors> errors;
  SLX_RETURN_IF_ERROR(AddComparison(graph, compare, metrics, &input.comparisons, &errors));
  SLX_RETURN_IF_ERROR(AddCentroid(graph, options.geometry, options.heldout, metrics));
  if (evaluation == Evaluation::kFull) {
    SLX_RETURN_IF_ERROR(EvaluateFully(graph, options, truth, metrics, errors));
  }
  metrics.intervals = FindIntervals(errors);

  metrics.session = frames.info().id;
  metrics.fit = FitIdOf(graph, options);
  metrics.program_version = kVersion;
  metrics.options_json = options.ToJson();
  metrics.evaluation = ToString(evaluation);
  metrics.evaluation_key = EvaluationKey(graph, options, evaluation);
  metrics.drift = shape->drift;
  metrics.motion = shape->motion.head;
  for (const auto& [stage, key] : keys) metrics.artifacts[stage] = stages.Node(key).identity.FolderName();
  for (const auto& [label, record] : graph.Records())
    metrics.stages.push_back({label, record.seconds, record.cpu_seconds, record.peak_rss_bytes});

  fs::path place = frames.store().FitFolder(metrics.session, metrics.fit);
  SLX_ASSIGN_OR_RETURN(const KeyLock lock, stages.store().Lock(LockOfFit(metrics.fit), kEnters));
  SLX_ASSIGN_OR_RETURN(const auto held, EvaluationHeld(graph, options, frames, metrics.fit));
  if (held && *held >= evaluation) return place;  // another run's, meanwhile
  const fs::path partial = place.string() + kPartial;
  const RemovedOnSignal guard(partial);
  std::error_code error;
  fs::remove_all(partial, error);
  db::FitRow row{metrics.fit, metrics.session, metrics.options_json, metrics.ToJson(), WallNow()};
  row.artifacts = metrics.artifacts;
  const auto make = [&]() -> Status {
    const fs::path below = partial.lexically_relative(frames.folder());
    SLX_RETURN_IF_ERROR(MakeFoldersBelow(frames.folder(), below / "report"));
    for (const auto& [stage, key] : keys) {
      SLX_ASSIGN_OR_RETURN(const fs::path folder, stages.StoredFolder(key));
      SLX_RETURN_IF_ERROR(LinkFiles(folder, partial));
    }
    const auto write_report = [&](const fs::path& folder) -> Status {
      SLX_RETURN_IF_ERROR(MakeFoldersBelow(folder, "report"));
      return WriteReport(folder, input, metrics, pictures);
    };
    SLX_RETURN_IF_ERROR(stages.store().files().Write(partial, db::PlaceOfFit(metrics.fit), write_report));
    SLX_RETURN_IF_ERROR(WriteText(partial / "metrics.json", row.metrics_json));
    // With its proof, on the disk, before it takes the place of one that is listed.
    SLX_ASSIGN_OR_RETURN(const std::string record, db::FitRecordOf(partial, row));
    SLX_RETURN_IF_ERROR(db::ReplaceFile(partial / db::kFitRecordFile, record));
    SLX_RETURN_IF_ERROR(db::SyncTree(partial));
    return PutInPlace(partial, place);
  };
  if (Status made = make(); !made.ok()) {
    // On a full disk its names would keep what `clean` frees.
    fs::remove_all(partial, error);
    return made;
  }
  SLX_RETURN_IF_ERROR(frames.store().RegisterFit(row, {.job_token = options.job_token}));
  return place;
}

}  // namespace stratalux::fit
