// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/session_graph.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "db/catalogue/fit_reader.h"
#include "fitter/evaluation/ablations.h"
#include "fitter/evaluation/compare.h"
#include "fitter/evaluation/truth_shape.h"
#include "fitter/mixture/em_kernel.h"
#include "fitter/scattering/baselines.h"
#include "fitter/sensor/linear_frame.h"
#include "fitter/stages/decode.h"
#include "fitter/stages/fit_summary.h"
#include "fitter/stages/layer_maps.h"
#include "fitter/stages/layers.h"
#include "fitter/stages/layers_file.h"
#include "fitter/stages/maps.h"
#include "fitter/stages/normals.h"
#include "fitter/stages/separate.h"
#include "fitter/stages/srd_file.h"
#include "shared/capture/plan.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using SortedJson = nlohmann::json;

constexpr int kStandardErrorsVersion = 2;
constexpr uint64_t kShuffleSeed = 1;

const char* ToString(FitKind kind) {
  switch (kind) {
    case FitKind::kJudged:
      return "none";
    case FitKind::kDirectionBlind:
      return "direction_blind";
    case FitKind::kProjectorsPermuted:
      return "projectors_permuted";
    case FitKind::kCombFramesShuffled:
      return "comb_frames_shuffled";
  }
  return "";
}

std::string SrdOptionsJson(const SrdOptions& o) {
  return SortedJson({{"pool", o.pool},
                     {"min_cos", o.min_cos},
                     {"min_signal_to_noise", o.min_signal_to_noise},
                     {"energy_tolerance", o.energy_tolerance},
                     {"reading", fit::ToString(o.reading)},
                     {"distance", fit::ToString(o.distance)}})
      .dump();
}

SrdSet Spoilt(SrdSet srds, FitKind kind, int heldout) {
  if (kind == FitKind::kProjectorsPermuted) return WithPermutedProjectors(std::move(srds), heldout);
  if (kind == FitKind::kCombFramesShuffled) return WithShuffledCombFrames(std::move(srds), kShuffleSeed);
  return srds;
}

bool IsBaseline(const std::string& model) { return model == "homogeneous" || model == "dipole"; }

Result<MixtureMap> DipoleBaseline(const MixtureMap& fit, StageGraph& stages, const std::string& srd, int heldout) {
  std::vector<Dipole> dipoles;
  {
    SLX_ASSIGN_OR_RETURN(const auto extracted, stages.Load(srd, LoadSrds));
    SLX_ASSIGN_OR_RETURN(const auto lights, TrainingLightsOf(extracted.set, heldout));
    for (int c = 0; c < fit.channels; ++c)
      dipoles.push_back(FitDipole(lights.batches, c, fit.channels, fit.scattering.eta, MeanSurfaceReflectance(fit, c)));
  }
  return DipoleMap(fit, dipoles);
}

}  // namespace

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
  SLX_ASSIGN_OR_RETURN(graph->frames_hash_, frames.FramesHash());
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
  return Add({{"decode", kDecodeVersion, "{}", {{"frames", frames_hash_}, {"record", record_hash_}}, ""},
              "decode",
              {},
              [this](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, Frames(record_));
                SLX_ASSIGN_OR_RETURN(const auto face, DecodeFace(*frames, logger_));
                std::string decoded = "decoded sites:";
                for (int r = 0; r < kDecodeReasons; ++r)
                  decoded += std::string(r == 0 ? " " : ", ") + fit::ToString(static_cast<DecodeReason>(r)) + " " +
                             std::to_string(face.counts[r]);
                logger_.Info(decoded);
                return SaveDecoded(folder, face);
              }});
}

std::string SessionGraph::Shape(GeometrySource source) {
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
                  SLX_ASSIGN_OR_RETURN(const auto reconstructed, stages_.Load(shape, LoadShape));
                  SLX_ASSIGN_OR_RETURN(const auto truth,
                                       SceneTruth::Open(fs::path(options_.store) / "sessions" / session_));
                  SLX_ASSIGN_OR_RETURN(const auto made, TruthShape(*truth, reconstructed, record_));
                  return SaveShape(folder, made);
                }});
  }
  const std::string decoded = Decode();
  return Add({{"shape", kShapeVersion, "{}", {{"decode", decoded}, {"record", record_hash_}}, ""},
              "shape",
              {decoded},
              [this, decoded](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const auto face, stages_.Load(decoded, LoadDecoded));
                SLX_ASSIGN_OR_RETURN(const auto shape, ReconstructShape(face.maps, LinearRig(record_), record_));
                return SaveShape(folder, shape);
              }});
}

std::string SessionGraph::Separate() {
  return Add({{"separate", kSeparateVersion, "{}", {{"frames", frames_hash_}, {"record", record_hash_}}, ""},
              "separate",
              {},
              [this](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, Frames(record_));
                SLX_ASSIGN_OR_RETURN(const auto maps, SeparateFace(*frames));
                return SaveSeparation(folder, maps);
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
                SLX_ASSIGN_OR_RETURN(const auto face, stages_.Load(shape, LoadShape));
                SLX_ASSIGN_OR_RETURN(const auto maps, stages_.Load(separate, LoadSeparation));
                SLX_ASSIGN_OR_RETURN(const auto normals, EstimateFaceNormals(maps, face.surface, LinearRig(face.record),
                                                                             plan_.exposure_ms));
                return SaveNormals(folder, normals);
              }});
}

std::string SessionGraph::Srd(GeometrySource source) {
  const std::string shape = Shape(source);
  return Add({{"srd", kSrdVersion, SrdOptionsJson(options_.srd), {{"frames", frames_hash_}, {"shape", shape}}, ""},
              source == GeometrySource::kTruth ? "srd, true geometry" : "srd",
              {shape},
              [this, shape](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const auto face, stages_.Load(shape, LoadShape));
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, Frames(face.record));
                ExtractedSrds srds;
                SLX_ASSIGN_OR_RETURN(srds.set,
                                     ExtractSrds(*frames, face.surface, face.lit, options_.srd, logger_, srds.figures));
                return SaveSrds(folder, srds);
              }});
}

std::string SessionGraph::Fit(GeometrySource source, int heldout, FitKind kind) {
  FitOptions fit = options_.fit;
  if (kind == FitKind::kDirectionBlind) {
    fit.em.scattering.mode = FitMode::kTied;
    fit.em.direction_blind = true;
  }
  const std::string what = kind == FitKind::kJudged ? "fit" : std::string("fit, ") + ToString(kind);
  return AddFit(Srd(source), heldout, fit, kind, LabelOf(what, source, heldout));
}

std::string SessionGraph::AddFit(const std::string& srd, int heldout, const FitOptions& fit, FitKind kind,
                                 const std::string& label) {
  SortedJson options = SortedJson::parse(FitOptionsJson(fit));
  options["heldout"] = heldout;
  options["spoilt"] = kind == FitKind::kDirectionBlind ? "none" : ToString(kind);
  if (kind == FitKind::kCombFramesShuffled) options["seed"] = kShuffleSeed;
  return Add({{"fit", kFitVersion, options.dump(), {{"srd", srd}}, isa_},
              label,
              {srd},
              [=, this](const fs::path& folder) -> Status {
                view_.Drop();
                layers_.Drop();
                SLX_ASSIGN_OR_RETURN(auto extracted, stages_.Load(srd, LoadSrds));
                const SrdSet srds = Spoilt(std::move(extracted.set), kind, heldout);
                FittedLayers layers;
                layers.pool = srds.pool;
                SLX_ASSIGN_OR_RETURN(layers.map, FitLayers(srds, heldout, fit, logger_, label));
                SLX_ASSIGN_OR_RETURN(const auto lights, TrainingLightsOf(srds, heldout));
                layers.signal_to_noise = SignalToNoise(layers.map, lights.batches);
                SLX_RETURN_IF_ERROR(SaveLayers(folder, layers));
                SLX_RETURN_IF_ERROR(WriteLayerMaps(folder, SummariseLayers(layers.map)));
                return SaveSummary(folder, Summarise(layers.map, srds, heldout));
              }});
}

std::string SessionGraph::Maps() {
  const std::string srd = Srd(options_.geometry), fit = Fit(options_.geometry, options_.heldout, FitKind::kJudged);
  SortedJson options = SortedJson::parse(FitOptionsJson(options_.fit));
  options["heldout"] = options_.heldout;
  return Add({{"maps", kMapsVersion, options.dump(), {{"srd", srd}, {"fit", fit}}, isa_},
              "maps, all projectors",
              {srd, fit},
              [=, this](const fs::path& folder) -> Status {
                view_.Drop();
                layers_.Drop();
                SLX_ASSIGN_OR_RETURN(const auto extracted, stages_.Load(srd, LoadSrds));
                SLX_ASSIGN_OR_RETURN(auto layers, stages_.Load(fit, LoadLayers));
                SLX_ASSIGN_OR_RETURN(const auto refined,
                                     RefineLayers(extracted.set, options_.heldout, std::move(layers), options_.fit,
                                                  logger_, "maps, all projectors"));
                return SaveMaps(folder, refined);
              }});
}

std::string SessionGraph::StandardErrors() {
  const std::string srd = Srd(options_.geometry), fit = Fit(options_.geometry, options_.heldout, FitKind::kJudged);
  return Add(
      {{"standard_errors", kStandardErrorsVersion, FitOptionsJson(options_.fit), {{"srd", srd}, {"fit", fit}}, isa_},
       "standard errors",
       {srd, fit},
       [=, this](const fs::path& folder) -> Status {
         SLX_ASSIGN_OR_RETURN(const auto extracted, stages_.Load(srd, LoadSrds));
         SLX_ASSIGN_OR_RETURN(const auto layers, stages_.Load(fit, LoadLayers));
         SLX_ASSIGN_OR_RETURN(const auto lights, TrainingLightsOf(extracted.set, options_.heldout));
         Progress progress(logger_, "standard errors", layers.map.profiles());
         return WriteStandardErrors(folder, FindStandardErrors(layers.map, lights.batches, options_.fit.em,
                                                               [&](int64_t done) { progress.Advance(done); }));
       }});
}

std::string SessionGraph::FitOf(const std::string& model, GeometrySource source, int heldout) {
  for (const FitKind kind : {FitKind::kDirectionBlind, FitKind::kProjectorsPermuted, FitKind::kCombFramesShuffled})
    if (model == ToString(kind)) return Fit(source, heldout, kind);
  return Fit(source, heldout, FitKind::kJudged);
}

Result<const SessionFrames*> SessionGraph::Frames(const RigCalibration& record) {
  return frames_.Of(record.ToJson(), [&]() -> Result<SessionFrames> {
    SLX_ASSIGN_OR_RETURN(auto frames, SessionFrames::Open(options_.store, session_));
    frames.UseRecord(record);
    return frames;
  });
}

Result<const HeldOutView*> SessionGraph::View(const std::string& shape, int heldout) {
  return view_.Of(shape + " " + std::to_string(heldout), [&]() -> Result<HeldOutView> {
    SLX_ASSIGN_OR_RETURN(auto face, stages_.Load(shape, LoadShape));
    return ViewOf(std::move(face), plan_, heldout, HeldOutLights(plan_));
  });
}

Result<const FittedLayers*> SessionGraph::Layers(const std::string& fit) {
  return layers_.Of(fit, [&] { return stages_.Load(fit, LoadLayers); });
}

std::string SessionGraph::Predict(const std::string& model, GeometrySource source, int heldout) {
  if (model == "homogeneous_local_albedo") return PredictLocalAlbedo(source, heldout);
  const std::string fit = FitOf(model, source, heldout), shape = Shape(source), srd = Srd(source);
  SortedJson options = {
      {"projector", heldout}, {"lights", HeldOutLights(plan_)}, {"plan", SortedJson::parse(PlanOptionsToJson(plan_))}};
  std::map<std::string, std::string> inputs = {{"fit", fit}, {"shape", shape}};
  std::vector<std::string> upstream = {fit, shape};
  if (IsBaseline(model)) options["baseline"] = model;
  if (model == "dipole") {
    inputs["srd"] = srd;
    upstream.push_back(srd);
  }
  return Add({{"predict", kPredictVersion, options.dump(), inputs, isa_},
              LabelOf("predict, " + model, source, heldout),
              upstream,
              [=, this](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const FittedLayers* fitted, Layers(fit));
                std::optional<MixtureMap> baseline;
                if (model == "homogeneous") baseline = Homogeneous(fitted->map);
                if (model == "dipole") {
                  SLX_ASSIGN_OR_RETURN(baseline, DipoleBaseline(fitted->map, stages_, srd, heldout));
                }
                SLX_ASSIGN_OR_RETURN(const HeldOutView* view, View(shape, heldout));
                return SavePredictions(folder, fit::Predict(baseline ? *baseline : fitted->map, fitted->pool, *view));
              }});
}

// Its layers are the homogeneous ones but for each pixel's total weight, in which light is linear: nothing is rendered.
std::string SessionGraph::PredictLocalAlbedo(GeometrySource source, int heldout) {
  const std::string fit = Fit(source, heldout, FitKind::kJudged), predicted = Predict("homogeneous", source, heldout);
  return Add({{"predict",
               kPredictVersion,
               SortedJson({{"baseline", "homogeneous_local_albedo"}}).dump(),
               {{"fit", fit}, {"predict", predicted}},
               isa_},
              LabelOf("predict, homogeneous_local_albedo", source, heldout),
              {fit, predicted},
              [=, this](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(auto predictions, stages_.Load(predicted, LoadPredictions));
                SLX_ASSIGN_OR_RETURN(const FittedLayers* fitted, Layers(fit));
                return SavePredictions(folder, ScaledPredictions(std::move(predictions), Homogeneous(fitted->map),
                                                                 HomogeneousLocalAlbedo(fitted->map), fitted->pool));
              }});
}

std::string SessionGraph::Compare(const std::vector<std::string>& models, GeometrySource source, int heldout) {
  const std::string shape = Shape(source), separate = Separate();
  std::vector<std::string> upstream = {shape, separate}, predictions;
  // Fits before predictions, which share what they are lit by.
  for (const std::string& model : models)
    if (!stages_.Has(Predict(model, source, heldout))) upstream.push_back(FitOf(model, source, heldout));
  std::map<std::string, std::string> inputs = {{"frames", frames_hash_}, {"shape", shape}, {"separate", separate}};
  if (has_truth()) inputs["truth"] = truth_hash_;
  for (const std::string& model : models) {
    predictions.push_back(Predict(model, source, heldout));
    inputs["predict:" + model] = predictions.back();
    upstream.push_back(predictions.back());
  }
  return Add({{"compare", kCompareVersion,
               SortedJson({{"models", models},
                           {"projector", heldout},
                           {"geometry", fit::ToString(source)},
                           {"pool", options_.srd.pool},
                           {"lights", HeldOutLights(plan_)}})
                   .dump(),
               inputs, ""},
              LabelOf("compare", source, heldout),
              upstream,
              [=, this](const fs::path& folder) -> Status {
                layers_.Drop();
                SLX_ASSIGN_OR_RETURN(const HeldOutView* view, View(shape, heldout));
                SLX_ASSIGN_OR_RETURN(const auto maps, stages_.Load(separate, LoadSeparation));
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, Frames(view->shape.record));
                SLX_ASSIGN_OR_RETURN(const auto truth, SceneTruth::Open(frames->folder()));
                std::vector<ComparedModel> compared;
                for (size_t m = 0; m < models.size(); ++m) {
                  SLX_ASSIGN_OR_RETURN(auto loaded, stages_.Load(predictions[m], LoadPredictions));
                  compared.push_back({models[m], std::move(loaded)});
                }
                const CompareInput input{
                    *frames, *view, maps[heldout], truth, options_.srd.pool, fit::ToString(source)};
                SLX_ASSIGN_OR_RETURN(const auto comparison, CompareHeldOut(input, compared));
                view_.Drop();
                return SaveComparison(folder, comparison);
              }});
}

}  // namespace stratalux::fit
