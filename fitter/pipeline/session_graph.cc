// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/session_graph.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "db/catalogue/fit_reader.h"
#include "fitter/evaluation/truth_shape.h"
#include "fitter/export/exr_file.h"
#include "fitter/mixture/em_kernel.h"
#include "fitter/sensor/linear_frame.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/decode.h"
#include "fitter/stages/diffuse_normals.h"
#include "fitter/stages/fit_summary.h"
#include "fitter/stages/layer_maps.h"
#include "fitter/stages/layers.h"
#include "fitter/stages/layers_file.h"
#include "fitter/stages/maps.h"
#include "fitter/stages/normals.h"
#include "fitter/stages/separate.h"
#include "fitter/stages/srd_file.h"
#include "shared/capture/plan.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using SortedJson = nlohmann::json;

constexpr int kStandardErrorsVersion = 7;

std::string SrdOptionsJson(const SrdOptions& o) {
  return SortedJson({{"pool", o.pool},
                     {"min_cos", o.min_cos},
                     {"min_signal_to_noise", o.min_signal_to_noise},
                     {"energy_tolerance", o.energy_tolerance},
                     {"reading", fit::ToString(o.reading)},
                     {"distance", fit::ToString(o.distance)}})
      .dump();
}

// What of the visit's plan is read; nothing where that is all of it.
Result<std::optional<ThinPlan>> ThinnedBy(const RunOptions& options, const PlanOptions& captured) {
  if (!options.frames) return std::optional<ThinPlan>();
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(captured));
  SLX_ASSIGN_OR_RETURN(ThinPlan thin, ThinTo(plan, *options.frames));
  if (thin.IsWhole()) return std::optional<ThinPlan>();
  if (!thin.columns && options.geometry == GeometrySource::kReconstructed)
    return Status::Usage("--frames " + std::to_string(*options.frames) +
                         ": no codes of columns are left, so no surface can be reconstructed; that takes " +
                         std::to_string(LeastForSurface(plan)) + " frames, or --geometry truth (simulated sessions)");
  if (options.standard_errors)
    return Status::Usage("standard errors need a whole sweep: leave out --frames or --standard-errors");
  SLX_RETURN_IF_ERROR(CheckReading(captured.comb_width, captured.comb_step * thin.comb_every, options.srd));
  return std::optional(std::move(thin));
}

}  // namespace

const char* ToString(FitKind kind) {
  switch (kind) {
    case FitKind::kJudged:
      return "none";
    case FitKind::kDirectionBlind:
      return "direction_blind";
    case FitKind::kDirectionBlindPlaced:
      return "direction_blind_placed";
    case FitKind::kProjectorsPermuted:
      return "projectors_permuted";
    case FitKind::kCombFramesShuffled:
      return "comb_frames_shuffled";
  }
  return "";
}

bool IsSpoilt(FitKind kind) { return kind == FitKind::kProjectorsPermuted || kind == FitKind::kCombFramesShuffled; }

SessionGraph::SessionGraph(const RunOptions& options, const SessionFrames& frames, ArtifactStore artifacts,
                           Logger& logger)
    : options_(options),
      session_(frames.info().id),
      record_(*frames.record()),
      plan_(*frames.plan()),
      logger_(logger),
      record_hash_(frames.RecordHash()),
      isa_(KernelIsa()),
      stages_(std::move(artifacts), logger) {}

Result<std::unique_ptr<SessionGraph>> SessionGraph::Open(const RunOptions& options, const SessionFrames& frames,
                                                         Logger& logger) {
  SLX_ASSIGN_OR_RETURN(auto seal, db::FindSeal(frames.store(), frames.info().id));
  SLX_ASSIGN_OR_RETURN(auto artifacts, ArtifactStore::Open(frames.folder(), PlainFiles(std::move(seal)), logger));
  std::unique_ptr<SessionGraph> graph(new SessionGraph(options, frames, std::move(artifacts), logger));
  SLX_ASSIGN_OR_RETURN(graph->thin_, ThinnedBy(options, graph->plan_));
  SLX_ASSIGN_OR_RETURN(graph->all_frames_hash_, frames.FramesHash());
  graph->frames_hash_ = graph->all_frames_hash_;
  if (graph->thin_) {
    SLX_ASSIGN_OR_RETURN(auto kept, SessionFrames::Open(options.store, frames.info().id));
    kept.KeepOnly(*graph->thin_);
    SLX_ASSIGN_OR_RETURN(graph->frames_hash_, kept.FramesHash());
  }
  const fs::path truth = frames.folder() / "truth.seg", exact = frames.folder() / "truth_calibration.json";
  std::error_code error;
  for (const fs::path& file : {truth, exact})
    if (fs::exists(truth, error) && fs::exists(file, error)) {
      SLX_ASSIGN_OR_RETURN(const std::string hash, db::HashOfFile(file));
      graph->truth_hash_ += hash;
    }
  return graph;
}

std::string SessionGraph::Add(StageNode node) {
  std::string key = stages_.Add(std::move(node));
  if (std::find(order_.begin(), order_.end(), key) == order_.end()) order_.push_back(key);
  return key;
}

std::vector<std::pair<std::string, db::ArtifactRecord>> SessionGraph::Records() const {
  std::vector<std::pair<std::string, db::ArtifactRecord>> records;
  for (const std::string& key : order_) {
    const StageNode& node = stages_.Node(key);
    const auto record = db::ReadArtifactRecord(stages_.store().FolderOf(node.identity));
    if (record.ok()) records.emplace_back(node.label, *record);
  }
  return records;
}

std::string SessionGraph::LabelOf(const std::string& what, GeometrySource source, int heldout) const {
  std::string label = what + ", projector " + std::to_string(heldout) + " held out";
  return source == GeometrySource::kTruth ? label + ", true geometry" : label;
}

std::string SessionGraph::Decode() {
  const db::ArtifactIdentity identity = {
      "decode", kDecodeVersion, "{}", {{"frames", frames_hash_}, {"record", record_hash_}}, ""};
  return Add({identity, "decode", {}, [this, key = stages_.KeyOf(identity)](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, Frames(record_));
                SLX_ASSIGN_OR_RETURN(auto face, DecodeFace(*frames, logger_));
                std::string decoded = "decoded sites:";
                for (int r = 0; r < kDecodeReasons; ++r)
                  decoded += std::string(r == 0 ? " " : ", ") + fit::ToString(static_cast<DecodeReason>(r)) + " " +
                             std::to_string(face.counts[r]);
                logger_.Info(decoded);
                SLX_RETURN_IF_ERROR(SaveDecoded(folder, face));
                decoded_.Put(key, std::move(face));
                return Status::Ok();
              }});
}

std::string SessionGraph::Shape(GeometrySource source) {
  if (source == GeometrySource::kTruth && thin_) {
    return Add({{"truth_shape",
                 kTruthShapeVersion,
                 SortedJson({{"alone", true}}).dump(),
                 {{"truth", truth_hash_}, {"record", record_hash_}},
                 ""},
                "shape, of the truth",
                {},
                [this](const fs::path& folder) -> Status {
                  SLX_ASSIGN_OR_RETURN(const auto truth,
                                       SceneTruth::Open(fs::path(options_.store) / "sessions" / session_));
                  SLX_ASSIGN_OR_RETURN(const auto made, TruthShapeAlone(*truth, record_));
                  return SaveShape(folder, made);
                }});
  }
  if (source == GeometrySource::kTruth) {
    const std::string shape = Shape(GeometrySource::kReconstructed);
    return Add({{"truth_shape",
                 kTruthShapeVersion,
                 "{}",
                 {{"shape", shape}, {"truth", truth_hash_}, {"record", record_hash_}},
                 ""},
                "shape, of the truth",
                {shape},
                [this, shape](const fs::path& folder) -> Status {
                  SLX_ASSIGN_OR_RETURN(const FaceShape* reconstructed, Face(shape));
                  SLX_ASSIGN_OR_RETURN(const auto truth,
                                       SceneTruth::Open(fs::path(options_.store) / "sessions" / session_));
                  SLX_ASSIGN_OR_RETURN(const auto made, TruthShape(*truth, *reconstructed, record_));
                  return SaveShape(folder, made);
                }});
  }
  const std::string decoded = Decode(), separate = Separate();
  return Add({{"shape",
               kShapeVersion,
               SortedJson({{"motion", options_.motion}}).dump(),
               {{"decode", decoded}, {"separate", separate}, {"frames", frames_hash_}, {"record", record_hash_}},
               ""},
              "shape",
              {decoded, separate},
              [=, this](const fs::path& folder) -> Status {
                const auto load = [&] { return stages_.Load(decoded, LoadDecoded); };
                SLX_ASSIGN_OR_RETURN(const DecodedFace* face, decoded_.Of(decoded, load));
                SLX_ASSIGN_OR_RETURN(const auto* separation, Separation(separate));
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, Frames(record_));
                SLX_ASSIGN_OR_RETURN(const auto shape, ReconstructMovingShape(*frames, face->maps, *separation, record_,
                                                                              options_.motion));
                if (options_.motion) logger_.Info(Describe(shape.motion));
                decoded_.Drop();  // nobody else reads it
                return SaveShape(folder, shape);
              }});
}

std::string SessionGraph::Separate() { return SeparateBy(frames_hash_, false); }

std::string SessionGraph::SeparateAll() { return thin_ ? SeparateBy(all_frames_hash_, true) : Separate(); }

std::string SessionGraph::SeparateBy(const std::string& frames_hash, bool of_all) {
  const db::ArtifactIdentity identity = {
      "separate", kSeparateVersion, "{}", {{"frames", frames_hash}, {"record", record_hash_}}, ""};
  const std::string label = of_all ? "separate, all frames" : "separate";
  return Add({identity, label, {}, [this, of_all, key = stages_.KeyOf(identity)](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, of_all ? AllFrames(record_) : Frames(record_));
                SLX_ASSIGN_OR_RETURN(auto maps, SeparateFace(*frames, logger_));
                SLX_RETURN_IF_ERROR(SaveSeparation(folder, maps));
                separation_.Put(key, std::move(maps));
                return Status::Ok();
              }});
}

std::string SessionGraph::Normals() {
  const std::string separate = Separate(), shape = Shape(options_.geometry);
  return Add({{"normals",
               kNormalsVersion,
               SortedJson({{"exposure_ms", plan_.exposure_ms}}).dump(),
               {{"separate", separate}, {"shape", shape}},
               ""},
              "normals",
              {separate, shape},
              [=, this](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const FaceShape* face, Face(shape));
                SLX_ASSIGN_OR_RETURN(const auto* maps, Separation(separate));
                const LightsOnShape lights = LightsOn(*face, *maps);
                SLX_ASSIGN_OR_RETURN(const auto normals,
                                     EstimateFaceNormals(lights.carried.empty() ? *maps : lights.carried, face->surface,
                                                         lights.rig, plan_.exposure_ms));
                return SaveNormals(folder, normals);
              }});
}

std::string SessionGraph::Skin() {
  const std::string separate = Separate(), shape = Shape(SkinSource());
  return Add({{"skin",
               kSkinVersion,
               SortedJson({{"exposure_ms", plan_.exposure_ms}}).dump(),
               {{"separate", separate}, {"shape", shape}},
               ""},
              "skin",
              {separate, shape},
              [=, this](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const FaceShape* face, Face(shape));
                SLX_ASSIGN_OR_RETURN(const auto* maps, Separation(separate));
                const LightsOnShape lights = LightsOn(*face, *maps);
                SLX_ASSIGN_OR_RETURN(const auto skin,
                                     JudgeFaceSkin(*face, lights.carried.empty() ? *maps : lights.carried, lights.rig,
                                                   plan_.exposure_ms));
                logger_.Info("skin: " + Describe(skin));
                return SaveSkin(folder, skin);
              }});
}

std::string SessionGraph::Srd(GeometrySource source) {
  const std::string shape = Shape(source);
  return Add({{"srd", kSrdVersion, SrdOptionsJson(options_.srd), {{"frames", frames_hash_}, {"shape", shape}}, ""},
              source == GeometrySource::kTruth ? "srd, true geometry" : "srd",
              {shape},
              [this, shape](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const FaceShape* face, Face(shape));
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, Frames(face->record));
                ExtractedSrds srds;
                SLX_ASSIGN_OR_RETURN(srds.set, ExtractSrds(*frames, *face, options_.srd, logger_, srds.figures));
                return SaveSrds(folder, srds);
              }});
}

FitOptions SessionGraph::FitOptionsOf(FitKind kind) const {
  FitOptions fit = options_.fit;
  if (kind == FitKind::kDirectionBlind || kind == FitKind::kDirectionBlindPlaced) {
    fit.em.scattering.mode = FitMode::kTied;
    fit.em.direction_blind = true;
  }
  return fit;
}

std::string SessionGraph::Offset(GeometrySource source, int heldout, FitKind kind) {
  if (source == GeometrySource::kTruth || !options_.offset) return "";
  const std::string srd = Srd(source), shape = Shape(source), skin = Skin();
  const bool own = kind == FitKind::kDirectionBlindPlaced;
  const FitOptions fit = FitOptionsOf(own ? kind : FitKind::kJudged);
  SortedJson options = SortedJson::parse(FitOptionsJson(fit));
  options.erase("neighbours");  // it samples pixels that have none
  options["heldout"] = heldout;
  const std::string what = own ? std::string("offset, ") + ToString(kind) : "offset";
  const std::string label = heldout == kNoneHeldOut ? "offset, all projectors" : LabelOf(what, source, heldout);
  return Add({{"offset", kOffsetVersion, options.dump(), {{"srd", srd}, {"shape", shape}, {"skin", skin}}, isa_},
              label,
              {srd, shape, skin},
              [=, this](const fs::path& folder) -> Status {
                MakeRoomForAFit();
                SLX_ASSIGN_OR_RETURN(const FaceShape* face, Face(shape));
                SLX_ASSIGN_OR_RETURN(const SrdSet* srds, Srds({srd, "", skin}, FitKind::kJudged, heldout));
                SLX_ASSIGN_OR_RETURN(const SharedLight shared, Shared({srd, "", skin}, *srds, heldout));
                SLX_ASSIGN_OR_RETURN(const auto offset, FindOffset(*srds, *face, heldout, fit, shared, logger_, label));
                return SaveOffset(folder, offset);
              }});
}

std::string SessionGraph::PlacedShape(GeometrySource source, int heldout, FitKind kind) {
  const std::string shape = Shape(source), offset = Offset(source, heldout, kind);
  if (offset.empty()) return shape;
  return Add({{"placed_shape", kPlacedShapeVersion, "{}", {{"shape", shape}, {"offset", offset}}, ""},
              heldout == kNoneHeldOut ? "shape, placed" : LabelOf("shape, placed", source, heldout),
              {shape, offset},
              [=, this](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const FaceShape* face, Face(shape));
                SLX_ASSIGN_OR_RETURN(const auto found, stages_.Load(offset, LoadOffset));
                return SaveShape(folder, fit::PlacedShape(*face, found));
              }});
}

std::map<std::string, std::string> SessionGraph::SrdKeys::Inputs() const {
  std::map<std::string, std::string> inputs = {{"srd", srd}, {"skin", skin}};
  if (!offset.empty()) inputs["offset"] = offset;
  return inputs;
}

std::vector<std::string> SessionGraph::SrdKeys::Upstream() const {
  return offset.empty() ? std::vector{srd, skin} : std::vector{srd, skin, offset};
}

std::string SessionGraph::Fit(GeometrySource source, int heldout, FitKind kind) {
  const std::string what = kind == FitKind::kJudged ? "fit" : std::string("fit, ") + ToString(kind);
  std::string key =
      AddFit(SrdsOf(source, heldout, kind), heldout, FitOptionsOf(kind), kind, LabelOf(what, source, heldout));
  if (kind == FitKind::kJudged && source == options_.geometry && heldout == options_.heldout) judged_fit_ = key;
  return key;
}

std::string SessionGraph::AddFit(const SrdKeys& from, int heldout, const FitOptions& fit, FitKind kind,
                                 const std::string& label) {
  SortedJson options = SortedJson::parse(FitOptionsJson(fit));
  options["heldout"] = heldout;
  options["spoilt"] = IsSpoilt(kind) ? ToString(kind) : ToString(FitKind::kJudged);
  if (kind == FitKind::kCombFramesShuffled) options["seed"] = kShuffleSeed;
  const db::ArtifactIdentity identity = {"fit", kFitVersion, options.dump(), from.Inputs(), isa_};
  return Add(
      {identity, label, from.Upstream(), [=, this, key = stages_.KeyOf(identity)](const fs::path& folder) -> Status {
         MakeRoomForAFit();
         SLX_ASSIGN_OR_RETURN(const SrdSet* read, Srds(from, kind, heldout));
         const SrdSet& srds = *read;
         FittedLayers layers;
         layers.pool = srds.pool;
         SLX_ASSIGN_OR_RETURN(const auto lights, TrainingLightsOf(srds, heldout));
         if (IsSpoilt(kind)) {
           SLX_ASSIGN_OR_RETURN(layers.map, FitLayers(srds, heldout, fit, logger_, label));
         } else {
           SLX_ASSIGN_OR_RETURN(const SharedLight shared, Shared(from, srds, heldout));
           SLX_ASSIGN_OR_RETURN(layers.map, FitLayers(srds, heldout, fit, shared, logger_, label));
         }
         layers.signal_to_noise = SignalToNoise(layers.map, lights.batches);
         SLX_RETURN_IF_ERROR(SaveLayers(folder, layers));
         SLX_RETURN_IF_ERROR(WriteLayerMaps(folder, SummariseLayers(layers.map)));
         SLX_RETURN_IF_ERROR(SaveSummary(folder, Summarise(layers.map, srds, heldout)));
         KeptLayers(key).Put(key, std::move(layers));
         return Status::Ok();
       }});
}

std::string SessionGraph::Maps() {
  const SrdKeys from = SrdsOf(options_.geometry, kNoneHeldOut);
  SortedJson options = SortedJson::parse(FitOptionsJson(options_.fit));
  options["heldout"] = options_.heldout;
  const std::string label = "maps, all projectors";
  return Add({{"maps", kMapsVersion, options.dump(), from.Inputs(), isa_},
              label,
              from.Upstream(),
              [=, this](const fs::path& folder) -> Status {
                MakeRoomForAFit();
                SLX_ASSIGN_OR_RETURN(const SrdSet* srds, Srds(from, FitKind::kJudged, options_.heldout));
                SLX_ASSIGN_OR_RETURN(const SharedLight shared, Shared(from, *srds, kNoneHeldOut));
                SLX_ASSIGN_OR_RETURN(const auto made,
                                     FitMaps(*srds, options_.heldout, options_.fit, shared, logger_, label));
                return SaveMaps(folder, made);
              }});
}

std::string SessionGraph::StandardErrors() {
  const SrdKeys from = SrdsOf(options_.geometry, options_.heldout);
  const std::string fit = Fit(options_.geometry, options_.heldout, FitKind::kJudged);
  auto inputs = from.Inputs();
  auto upstream = from.Upstream();
  inputs["fit"] = fit;
  // Of two projectors a fit that leaves one out has nothing to disagree with.
  std::vector<std::string> left_out;
  const int projectors = static_cast<int>(record_.projectors.size());
  for (int p = 0; p < projectors && projectors > 2; ++p) {
    left_out.push_back(Fit(options_.geometry, p, FitKind::kJudged));
    inputs["left_out:" + std::to_string(p)] = left_out.back();
    upstream.push_back(left_out.back());
  }
  upstream.push_back(fit);
  return Add({{"standard_errors", kStandardErrorsVersion, FitOptionsJson(options_.fit), inputs, isa_},
              "standard errors",
              upstream,
              [=, this](const fs::path& folder) -> Status {
                const int colours = QuadChannels(record_.camera.cfa);
                const auto load = [&](const fs::path& of) { return LoadEffectiveMaps(of, colours); };
                std::vector<EffectiveMaps> others;
                for (const std::string& key : left_out) {
                  SLX_ASSIGN_OR_RETURN(auto maps, stages_.Load(key, load));
                  others.push_back(std::move(maps));
                }
                SLX_ASSIGN_OR_RETURN(const auto values, stages_.Load(fit, load));
                SLX_ASSIGN_OR_RETURN(const SrdSet* srds, Srds(from, FitKind::kJudged, options_.heldout));
                SLX_ASSIGN_OR_RETURN(const FittedLayers* layers, Layers(fit));
                SLX_ASSIGN_OR_RETURN(const auto lights, TrainingLightsOf(*srds, options_.heldout));
                Progress progress(logger_, "standard errors", layers->map.profiles());
                const EffectiveMaps noise = FindStandardErrors(layers->map, lights.batches, options_.fit.em,
                                                               [&](int64_t done) { progress.Advance(done); });
                const int radius = static_cast<int>(std::lround(kDisagreementMm / std::max(srds->spacing_mm, 1e-3)));
                return WriteStandardErrors(
                    folder, others.empty() ? noise : WithDisagreement(noise, values, others, radius), noise);
              }});
}

std::string SessionGraph::ShownFit() {
  return options_.MakesMaps() ? Maps() : Fit(options_.geometry, options_.heldout, FitKind::kJudged);
}

Result<Image<float>> SessionGraph::ShownWidths() {
  const auto load = [this](const fs::path& folder) {
    return ReadExr((options_.MakesMaps() ? folder / kMapsFolder : folder) / kEffectiveWidthFile,
                   Colours(QuadChannels(record_.camera.cfa)));
  };
  return stages_.Load(ShownFit(), load);
}

std::string SessionGraph::DiffuseNormals() {
  const std::string shape = PlacedShape(options_.geometry, kNoneHeldOut), normals = Normals(), layers = ShownFit();
  return Add({{"diffuse_normals",
               kDiffuseNormalsVersion,
               "{}",
               {{"shape", shape}, {"normals", normals}, {"layers", layers}},
               ""},
              "diffuse normals",
              {shape, normals, layers},
              [=, this](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const FaceShape* face, Face(shape));
                const int colours = QuadChannels(record_.camera.cfa);
                const auto load = [&](const fs::path& from) { return LoadNormals(from, colours); };
                SLX_ASSIGN_OR_RETURN(const auto specular, stages_.Load(normals, load));
                MakeRoomForAFit();
                SLX_ASSIGN_OR_RETURN(const auto shown,
                                     stages_.Load(layers, options_.MakesMaps() ? LoadMaps : LoadLayers));
                SLX_ASSIGN_OR_RETURN(const auto diffuse, FilterNormals(*face, specular.fused, shown));
                return SaveDiffuseNormals(folder, diffuse);
              }});
}

FitKind SessionGraph::KindOf(const std::string& model) {
  for (const FitKind kind : {FitKind::kDirectionBlind, FitKind::kDirectionBlindPlaced, FitKind::kProjectorsPermuted,
                             FitKind::kCombFramesShuffled})
    if (model == ToString(kind)) return kind;
  return FitKind::kJudged;
}

std::string SessionGraph::FitOf(const std::string& model, GeometrySource source, int heldout) {
  return Fit(source, heldout, KindOf(model));
}

}  // namespace stratalux::fit
