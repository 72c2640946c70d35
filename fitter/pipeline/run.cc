// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/run.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <sstream>

#include <nlohmann/json.hpp>

#include "db/catalogue/deletions.h"
#include "db/catalogue/fit_store.h"
#include "db/catalogue/shortfall.h"
#include "db/privacy/access_log.h"
#include "fitter/pipeline/ablations.h"
#include "fitter/pipeline/content_hash.h"
#include "fitter/pipeline/saved_fit.h"
#include "fitter/scattering/baselines.h"
#include "shared/base/version.h"

namespace stratalux::fit {
namespace {

constexpr std::array<const char*, 9> kStages = {"decode", "reconstruct", "separate", "normals", "srd",
                                                "fit",    "render",      "evaluate", "report"};

// State of one run, filled stage by stage.
struct Work {
  const RunOptions& options;
  Logger& logger;
  SessionFrames frames;
  StageClock clock;
  FaceGeometry face;
  SurfaceMap surface;
  std::optional<SceneTruth> truth;
  SrdSet srds;
  MixtureMap map;
  Metrics metrics;
  RunPictures pictures;
};

Status RequireFittable(const SessionFrames& frames) {
  const std::string where = "session " + frames.info().id;
  if (!frames.plan() || frames.info().kind != SessionKind::kVisitor)
    return Status::Usage(where + " is no visitor's capture: only `decode` can work on it");
  if (!frames.calibration()) return Status::Usage(where + " names no calibration");
  if (frames.info().status == SessionStatus::kFailed || frames.info().status == SessionStatus::kRecording)
    return Status::Failed(where + " is " + ToString(frames.info().status) + ": capture the visitor again");
  if (static_cast<int>(frames.calibration()->projectors.size()) != frames.plan()->projectors)
    return Status::Usage(where + ": its calibration has " + std::to_string(frames.calibration()->projectors.size()) +
                         " projectors, its plan " + std::to_string(frames.plan()->projectors));
  return Status::Ok();
}

// Share of the fitted weight in layers wider than one line: what scattering, not the surface, contributes.
double WideWeightFraction(const MixtureMap& map, double line_mm) {
  double wide = 0.0, all = 0.0;
  const size_t lights = map.training_projectors.size();
  for (int64_t i = 0; i < map.profiles(); ++i) {
    if (!map.Fitted(i)) continue;
    for (int l = 0; l < map.layers; ++l) {
      const double w = map.weight[i * map.layers + l];
      all += w;
      if (map.sigma_mm[i * map.layers + l] > line_mm) wide += w;
    }
    for (size_t p = 0; p < lights; ++p) all += map.surface[i * lights + p] / static_cast<double>(lights);
  }
  return all > 0.0 ? wide / all : 0.0;
}

double MeanLineWidth(const SrdSet& srds) {
  double sum = 0.0, count = 0.0;
  for (const SrdBatch& b : srds.batches)
    for (int64_t i = 0; i < b.profiles(); ++i)
      if (b.valid[i] != 0) {
        sum += b.line_width_mm[i];
        count += 1.0;
      }
  return count > 0.0 ? sum / count : 0.6;
}

void SummariseFit(const MixtureMap& map, const SrdSet& srds, Metrics& metrics) {
  std::vector<float> divergence;
  std::vector<int> iterations;
  for (int64_t i = 0; i < map.profiles(); ++i) {
    const auto reason = static_cast<FitReason>(map.reason[i]);
    if (map.Fitted(i)) {
      divergence.push_back(map.divergence[i]);
      iterations.push_back(map.iterations[i]);
    }
    if (reason != FitReason::kFitted) ++metrics.masked_by_reason[ToString(reason)];
  }
  metrics.pixels = static_cast<int64_t>(divergence.size());
  metrics.tau = map.tau;
  metrics.prior_photons = map.prior_photons;
  metrics.reflection = map.reflection;
  metrics.wide_weight_fraction = WideWeightFraction(map, MeanLineWidth(srds));
  if (divergence.empty()) return;
  std::nth_element(divergence.begin(), divergence.begin() + static_cast<int64_t>(divergence.size() / 2),
                   divergence.end());
  std::nth_element(iterations.begin(), iterations.begin() + static_cast<int64_t>(iterations.size() / 2),
                   iterations.end());
  metrics.divergence = divergence[divergence.size() / 2];
  metrics.iterations_median = iterations[iterations.size() / 2];
}

HoldOutInput InputFor(const Work& w, const SurfaceMap& surface, int projector, int pool, const std::string& geometry) {
  return {w.frames, w.face, surface, w.truth, projector, pool, geometry};
}

std::string NameOf(FitMode mode) { return mode == FitMode::kTied ? "tied" : "free"; }

// A fit with the baselines derived from it, and a direction-blind fit of the same data.
struct Models {
  MixtureMap fit, homogeneous, homogeneous_local_albedo, direction_blind;
  [[nodiscard]] std::vector<ModelToCompare> List(const std::string& name) const {
    return {{name, &fit},
            {"homogeneous", &homogeneous},
            {"homogeneous_local_albedo", &homogeneous_local_albedo},
            {"direction_blind", &direction_blind}};
  }
};

Result<Models> FitBaselines(Work& w, const SrdSet& srds, int projector, MixtureMap fit, const std::string& label) {
  Models m;
  m.fit = std::move(fit);
  m.homogeneous = Homogeneous(m.fit);
  m.homogeneous_local_albedo = HomogeneousLocalAlbedo(m.fit);
  EmOptions blind = w.options.em;
  blind.mode = FitMode::kTied;
  blind.direction_blind = true;
  SLX_ASSIGN_OR_RETURN(m.direction_blind, FitLayers(srds, projector, blind, w.logger, label + ", direction-blind"));
  return m;
}

Status HoldOut(Work& w, int projector, const std::string& geometry) {
  const std::string label = "projector " + std::to_string(projector) + " held out";
  SLX_ASSIGN_OR_RETURN(auto fit, FitLayers(w.srds, projector, w.options.em, w.logger, label));
  w.metrics.centroids.push_back({projector, geometry, CompareCentroids(fit, w.srds.batches[projector])});
  SLX_ASSIGN_OR_RETURN(const auto models, FitBaselines(w, w.srds, projector, std::move(fit), label));
  return CompareHeldOut(InputFor(w, w.surface, projector, w.options.srd.pool, geometry),
                        models.List(NameOf(w.options.em.mode)), {"stripe", "white"}, w.metrics.heldout)
      .status();
}

// What must get worse: the training lights' directions given to each other, the frames of each comb cycle shuffled.
Status Ablate(Work& w, const std::string& geometry) {
  const int projector = w.options.heldout;
  auto baseline_of = [&](const HeldOutFigure& f) {
    for (const HeldOutFigure& b : w.metrics.heldout)
      if (b.projector == projector && b.model == NameOf(w.options.em.mode) && b.light == f.light && b.part == f.part &&
          b.direct == f.direct && b.geometry == f.geometry)
        return b.error.nrmse;
    return std::nan("");
  };
  auto ablate = [&](const std::string& name) -> Status {
    SLX_ASSIGN_OR_RETURN(const auto map, FitLayers(w.srds, projector, w.options.em, w.logger, "ablation " + name));
    std::vector<HeldOutFigure> figures;
    SLX_RETURN_IF_ERROR(
        CompareHeldOut(InputFor(w, w.surface, projector, w.srds.pool, geometry), {{name, &map}}, {"stripe"}, figures)
            .status());
    for (const HeldOutFigure& f : figures)
      if (f.direct != "rendered")
        w.metrics.ablations.push_back({name, projector, f.light, f.part, f.error.nrmse, baseline_of(f)});
    return Status::Ok();
  };
  {
    const PermutedProjectors spoilt(w.srds, projector);
    SLX_RETURN_IF_ERROR(ablate("projectors_permuted"));
  }
  const ShuffledCombFrames spoilt(w.srds, 1);
  return ablate("comb_frames_shuffled");
}

Status EvaluateOnTrueSurface(Work& w) {
  const int projector = w.options.heldout;
  SLX_ASSIGN_OR_RETURN(const auto surface, w.truth->Surface(*w.frames.calibration()));
  w.srds = {};
  std::vector<SweepFigure> figures;
  SLX_ASSIGN_OR_RETURN(w.srds, ExtractSrds(w.frames, surface, w.face.lit, w.options.srd, w.logger, figures));
  SLX_ASSIGN_OR_RETURN(auto fit, FitLayers(w.srds, projector, w.options.em, w.logger, "true geometry"));
  w.metrics.centroids.push_back({projector, "truth", CompareCentroids(fit, w.srds.batches[projector])});
  SLX_ASSIGN_OR_RETURN(const auto models, FitBaselines(w, w.srds, projector, std::move(fit), "true geometry"));
  const HoldOutInput input = InputFor(w, surface, projector, w.srds.pool, "truth");
  const std::string mode = NameOf(w.options.em.mode);
  SLX_RETURN_IF_ERROR(CompareHeldOut(input, models.List(mode), {"stripe"}, w.metrics.heldout).status());
  std::vector<std::string> lights = {"white"};
  if (w.frames.plan()->spot_radius > 0) lights.push_back("spot");
  return CompareHeldOut(input, {{mode, &models.fit}, {"direction_blind", &models.direction_blind}}, lights,
                        w.metrics.heldout)
      .status();
}

// The same fit on the true surface, and in the rig as it truly is where the session names a calibration of its own:
// what of the error is the model's, not the reconstruction's. Last of all: its SRDs take the place of the others, so
// that memory holds one set.
Status EvaluateOnTruth(Work& w) {
  const RigCalibration own = *w.frames.record();
  if (const auto& exact = w.truth->exact_calibration()) w.frames.UseRecord(*exact);
  const Status status = EvaluateOnTrueSurface(w);
  w.frames.UseRecord(own);
  return status;
}

Status EvaluateFully(Work& w) {
  const int projectors = static_cast<int>(w.frames.calibration()->projectors.size());
  const std::string geometry = w.options.geometry == GeometrySource::kTruth ? "truth" : "reconstructed";
  w.clock.Start("evaluate: ablations");
  SLX_RETURN_IF_ERROR(Ablate(w, geometry));
  for (int p = 0; p < projectors; ++p) {
    if (p == w.options.heldout) continue;
    w.clock.Start("evaluate: hold out projector " + std::to_string(p));
    SLX_RETURN_IF_ERROR(HoldOut(w, p, geometry));
  }
  if (!w.truth || w.options.geometry != GeometrySource::kReconstructed) return Status::Ok();
  w.clock.Start("evaluate: true geometry");
  return EvaluateOnTruth(w);
}

Status CompareFullSize(Work& w) {
  w.clock.Start("render");
  const std::string geometry = w.options.geometry == GeometrySource::kTruth ? "truth" : "reconstructed";
  const std::string model = NameOf(w.options.em.mode);
  const int projector = w.options.heldout;
  const HoldOutInput input = InputFor(w, w.surface, projector, w.options.srd.pool, geometry);
  SLX_ASSIGN_OR_RETURN(w.pictures.comparisons,
                       CompareHeldOut(input, {{model, &w.map}}, {"stripe", "white"}, w.metrics.heldout));
  w.metrics.centroids.push_back({projector, geometry, CompareCentroids(w.map, w.srds.batches[projector])});
  const MixtureMap mean = Homogeneous(w.map);
  SLX_ASSIGN_OR_RETURN(w.pictures.homogeneous,
                       CompareHeldOut(input, {{"homogeneous", &mean}}, {"stripe", "white"}, w.metrics.heldout));
  if (w.truth) {
    SLX_ASSIGN_OR_RETURN(const auto depth, w.truth->Depth());
    SLX_ASSIGN_OR_RETURN(const auto normal, w.truth->Normal());
    w.metrics.truth = CompareSurface(w.surface, depth, normal);
  }
  if (!w.options.full_evaluation) return Status::Ok();

  w.clock.Start("evaluate: baselines");
  SLX_ASSIGN_OR_RETURN(const auto models, FitBaselines(w, w.srds, projector, w.map, "fit"));
  std::vector<int> training;
  SLX_ASSIGN_OR_RETURN(const auto batches, TrainingLights(w.srds, projector, &training));
  std::vector<Dipole> dipoles;
  for (int c = 0; c < w.srds.channels; ++c) dipoles.push_back(FitDipole(batches, c, w.srds.channels, w.options.em.eta));
  SLX_ASSIGN_OR_RETURN(const auto dipole, DipoleMap(w.map, dipoles));
  SLX_RETURN_IF_ERROR(CompareHeldOut(input,
                                     {{"homogeneous_local_albedo", &models.homogeneous_local_albedo},
                                      {"direction_blind", &models.direction_blind},
                                      {"dipole", &dipole}},
                                     {"stripe", "white"}, w.metrics.heldout)
                          .status());
  if (w.frames.plan()->spot_radius == 0) return Status::Ok();
  return CompareHeldOut(input, {{model, &w.map}, {"direction_blind", &models.direction_blind}}, {"spot"},
                        w.metrics.heldout)
      .status();
}

Status WriteText(const std::filesystem::path& file, const std::string& text) {
  std::ofstream out(file, std::ios::trunc);
  out << text;
  out.flush();
  return out ? Status::Ok() : Status::Failed("cannot write " + file.string());
}

// Runs the stages into `folder`; a stage beyond options.until is left out.
Status RunStages(Work& w, const std::filesystem::path& folder) {
  SLX_ASSIGN_OR_RETURN(w.face, ReconstructFace(w.frames, w.clock, w.logger));
  w.surface = w.face.surface;
  SLX_ASSIGN_OR_RETURN(w.metrics.drift, CheckDrift(w.face.decoded, w.surface, *w.frames.calibration()));
  if (!w.metrics.drift.warning.empty()) w.logger.Warning(w.metrics.drift.warning);
  std::string decoded = "decoded sites:";
  for (int r = 0; r < kDecodeReasons; ++r)
    decoded += std::string(r == 0 ? " " : ", ") + ToString(static_cast<DecodeReason>(r)) + " " +
               std::to_string(w.face.decode_counts[r]);
  w.logger.Info(decoded);
  if (w.options.geometry == GeometrySource::kTruth) {
    SLX_ASSIGN_OR_RETURN(w.surface, w.truth->Surface(*w.frames.calibration()));
  }
  SLX_RETURN_IF_ERROR(WriteMaps(folder, w.face, w.surface));
  if (w.options.until < Stage::kSrd) return Status::Ok();
  w.clock.Start("srd");
  SLX_ASSIGN_OR_RETURN(w.srds, ExtractSrds(w.frames, w.surface, w.face.lit, w.options.srd, w.logger, w.metrics.sweeps));
  if (w.options.until < Stage::kFit) return Status::Ok();
  w.clock.Start("fit");
  SLX_ASSIGN_OR_RETURN(w.map, FitLayers(w.srds, w.options.heldout, w.options.em, w.logger, "fit"));
  SummariseFit(w.map, w.srds, w.metrics);
  if (w.metrics.pixels == 0) {
    std::string reasons;
    for (const auto& [reason, count] : w.metrics.masked_by_reason)
      reasons += (reasons.empty() ? "" : ", ") + reason + " " + std::to_string(count);
    return Status::Failed("no pixel could be fitted (" + reasons +
                          "): is the face in the picture, lit and in focus? (`stratalux-fit separate` shows it)");
  }
  ShowLayers(w.map, w.srds, w.pictures);
  w.pictures.layer_maps = SummariseLayers(w.map);
  w.pictures.signal_to_noise = SignalToNoise(w.map, w.srds);
  for (int64_t i = 0; i < w.map.profiles(); ++i)
    if (w.map.Fitted(i) && !w.map.prior_share.empty() && w.map.prior_share[i] > 0.5F) ++w.metrics.weak_pixels;
  SLX_RETURN_IF_ERROR(WriteLayers(folder, w.map, w.pictures.signal_to_noise, w.options.srd.pool));
  SLX_RETURN_IF_ERROR(WriteLayerMaps(folder, w.pictures.layer_maps));
  if (w.options.standard_errors) {
    w.clock.Start("standard errors");
    Progress progress(w.logger, "standard errors", w.map.profiles());
    SLX_RETURN_IF_ERROR(WriteStandardErrors(
        folder, FindStandardErrors(w.map, w.srds, w.options.em, [&](int64_t done) { progress.Advance(done); })));
  }
  if (w.options.until < Stage::kRender) return Status::Ok();
  SLX_RETURN_IF_ERROR(CompareFullSize(w));
  if (w.options.full_evaluation && w.options.until >= Stage::kEvaluate) SLX_RETURN_IF_ERROR(EvaluateFully(w));
  w.clock.Start("report");
  return Status::Ok();
}

}  // namespace

const char* ToString(Stage stage) { return kStages[static_cast<size_t>(stage)]; }

Result<Stage> ParseStage(const std::string& text) {
  for (size_t i = 0; i < kStages.size(); ++i)
    if (text == kStages[i]) return static_cast<Stage>(i);
  return Status::Usage("stage '" + text + "' is unknown");
}

Status RunOptions::Validate() const {
  SLX_RETURN_IF_ERROR(em.Validate());
  if (heldout < 0 || heldout > 15)
    return Status::Usage("held-out projector " + std::to_string(heldout) + " must lie in 0 .. 15");
  if (standard_errors && em.mode == FitMode::kFree)
    return Status::Usage("standard errors are those of a tied fit: leave out --mode free or --standard-errors");
  if (em.choose_directions && em.mode == FitMode::kFree)
    return Status::Usage("directional weights are those of a tied fit: leave out --mode free or --directional on");
  return srd.Validate();
}

namespace {

std::string PriorText(const EmOptions& em) {
  if (em.choose_prior) return "auto";
  if (!(em.prior.photons > 0.0)) return "none";
  std::ostringstream text;
  text << em.prior.photons;
  return text.str();
}

}  // namespace

std::string RunOptions::ToJson() const {
  const nlohmann::ordered_json json = {{"layers", em.layers},
                                       {"mode", em.mode == FitMode::kTied ? "tied" : "free"},
                                       {"shift", fit::ToString(em.shift_law)},
                                       {"eta", em.eta},
                                       {"gain_model", em.gain_model},
                                       {"directional", em.choose_directions},
                                       {"surface", em.estimate_reflection ? "model" : "free"},
                                       {"background", em.background_term},
                                       {"iterations", em.max_iterations},
                                       {"prior", PriorText(em)},
                                       {"tolerance", em.tolerance},
                                       {"heldout", heldout},
                                       {"pool", srd.pool},
                                       {"reading", fit::ToString(srd.reading)},
                                       {"distance", fit::ToString(srd.distance)},
                                       {"full_evaluation", full_evaluation},
                                       {"standard_errors", standard_errors},
                                       {"geometry", geometry == GeometrySource::kTruth ? "truth" : "reconstructed"}};
  return json.dump();
}

namespace {

// A folder of the right name may lack its row: the power failed in between.
Result<bool> IsListed(const db::SessionStore& store, const RunOutcome& outcome) {
  SLX_ASSIGN_OR_RETURN(const auto fits, store.ListFits(outcome.session));
  return std::any_of(fits.begin(), fits.end(), [&outcome](const db::FitRow& fit) { return fit.id == outcome.fit; });
}

// The stages, and for a whole fit its report, its name and its row.
Status Finish(Work& w, const RunOptions& options, const RunOutcome& outcome, const std::filesystem::path& folder) {
  if (const Status status = RunStages(w, folder); !status.ok()) {
    const std::string session = "session " + outcome.session;
    return status.message().starts_with(session) ? status : status.WithContext(session);
  }
  SLX_RETURN_IF_ERROR(db::LogAccess(options.store, "fit", outcome.session, "fit " + outcome.fit));
  if (options.until != Stage::kReport) return Status::Ok();
  w.metrics.session = outcome.session;
  w.metrics.fit = outcome.fit;
  w.metrics.program_version = kVersion;
  w.metrics.options_json = options.ToJson();
  w.pictures.frames = &w.frames;
  w.pictures.face = &w.face;
  w.pictures.surface = &w.surface;
  w.pictures.heldout = options.heldout;
  w.clock.Stop();
  for (const StageTime& s : w.clock.stages())
    w.metrics.stages.push_back({s.name, s.seconds, s.cpu_seconds, s.peak_rss_bytes});
  SLX_RETURN_IF_ERROR(WriteReport(folder, w.pictures, w.metrics));
  SLX_RETURN_IF_ERROR(WriteText(folder / "metrics.json", w.metrics.ToJson()));
  std::error_code error;
  std::filesystem::remove_all(outcome.folder, error);
  std::filesystem::rename(folder, outcome.folder, error);
  if (error) return Status::Failed("cannot move " + folder.string() + ": " + error.message());
  return w.frames.store().RegisterFit({outcome.fit, outcome.session, options.ToJson(), w.metrics.ToJson(), WallNow()});
}

// Nothing stays of a whole fit that failed, nor of any work on a session that was forgotten meanwhile: folders that
// the stages made anew would bring back what a visitor had removed. That it was forgotten is then what is said.
Status AfterFinish(const Status& finished, const RunOptions& options, const RunOutcome& outcome,
                   const std::filesystem::path& folder) {
  SLX_ASSIGN_OR_RETURN(const bool forgotten, db::IsForgotten(options.store, outcome.session));
  if (!forgotten && (finished.ok() || options.until != Stage::kReport)) return finished;
  const Status discarded = db::DiscardFit(options.store, outcome.session, folder);
  return forgotten ? discarded : finished;
}

}  // namespace

Result<RunOutcome> RunSession(const RunOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(auto frames, SessionFrames::Open(options.store, options.session));
  for (const std::string& note : frames.store().notes()) logger.Warning(note);
  if (const std::string text = db::Shortfall(frames.info()); !text.empty()) logger.Warning(text);
  SLX_RETURN_IF_ERROR(RequireFittable(frames));
  if (options.heldout >= static_cast<int>(frames.calibration()->projectors.size()))
    return Status::Usage("held-out projector " + std::to_string(options.heldout) + " does not exist; allowed: 0 .. " +
                         std::to_string(frames.calibration()->projectors.size() - 1));
  if (frames.calibration()->projectors.size() < 2 && options.until >= Stage::kFit)
    return Status::Usage("session " + frames.info().id +
                         " has one projector only: the layers are fitted on all projectors but the held-out one, so "
                         "two are needed at least (`stratalux-fit srd` works with one)");
  RunOutcome outcome;
  outcome.session = frames.info().id;
  SLX_ASSIGN_OR_RETURN(const std::string content, frames.ContentHash());
  outcome.fit = ContentHashOf(content + options.ToJson() + kVersion).substr(0, 16);
  outcome.folder = frames.store().FitFolder(outcome.session, outcome.fit);
  SLX_ASSIGN_OR_RETURN(const bool listed, IsListed(frames.store(), outcome));
  if (!options.force && options.until == Stage::kReport && listed &&
      std::filesystem::exists(outcome.folder / "report" / "index.html")) {
    logger.Info("fit " + outcome.fit + " is complete already (--force fits again)");
    outcome.was_complete = true;
    return outcome;
  }
  SLX_ASSIGN_OR_RETURN(auto truth, SceneTruth::Open(frames.folder()));
  if (options.geometry == GeometrySource::kTruth && !truth)
    return Status::Usage("session " + outcome.session +
                         " has no truth: --geometry truth works on simulated sessions with their truth.seg");
  // Everything is written beside the final name and renamed when complete: a fit is visible only whole.
  const auto folder =
      options.until == Stage::kReport ? std::filesystem::path(outcome.folder.string() + ".partial") : outcome.folder;
  std::error_code error;
  std::filesystem::remove_all(folder, error);
  std::filesystem::create_directories(folder / "report", error);
  if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());

  if (options.geometry == GeometrySource::kTruth && truth->exact_calibration())
    frames.UseRecord(*truth->exact_calibration());
  Work w{options, logger, std::move(frames), StageClock(logger), {}, {}, std::move(truth), {}, {}, {}, {}};
  if (w.frames.info().simulated && !w.truth)
    logger.Warning("session " + outcome.session +
                   " is simulated but has no truth.seg: nothing is compared with the truth");
  SLX_RETURN_IF_ERROR(AfterFinish(Finish(w, options, outcome, folder), options, outcome, folder));
  w.clock.Stop();
  outcome.metrics = w.metrics;
  return outcome;
}

Result<std::filesystem::path> NewestFit(const std::string& store_folder, const std::string& session) {
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(store_folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto row, store.FindSession(session));
  SLX_ASSIGN_OR_RETURN(const auto fits, store.ListFits(row.info.id));
  if (fits.empty())
    return Status::NotFound("session " + row.info.id + " has no complete fit (`stratalux-fit run " + row.info.id +
                            "`)");
  return store.FitFolder(row.info.id, fits[0].id);
}

}  // namespace stratalux::fit
