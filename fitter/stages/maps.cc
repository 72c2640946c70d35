// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/maps.h"

#include <algorithm>
#include <cmath>

#include "fitter/stages/layer_maps.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

std::string Describe(const WarmStartChoice& warm) {
  if (warm.profiles == 0) return "the held-out projector reaches no profile of the fit";
  return Formatted(
      "%d sweeps from the fit's layers, %.3f nats a profile above EM that has settled (%d sweeps from the "
      "prior's centre: %.3f)",
      warm.sweeps, warm.trials.back().excess_nats, warm.cold_sweeps, warm.cold_nats);
}

double MedianDivergence(const MixtureMap& map) {
  std::vector<float> values;
  for (int64_t i = 0; i < map.profiles(); ++i)
    if (map.Fitted(i)) values.push_back(map.divergence[i]);
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<int64_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Of profiles that kept their layers it stays that of the lights that these were fitted to.
Image<float> RefinedSignalToNoise(const RefinedMap& refined, std::span<const SrdBatch* const> lights,
                                  const Image<float>& of_fit) {
  Image<float> ratio = SignalToNoise(refined.map, lights);
  for (int64_t i = 0; i < refined.map.profiles(); ++i)
    if (!std::isfinite(refined.cost[i])) ratio.pixels()[i] = of_fit.pixels()[i];
  return ratio;
}

}  // namespace

Result<RefinedLayers> RefineLayers(const SrdSet& srds, int heldout, FittedLayers fit, const FitOptions& options,
                                   Logger& logger, const std::string& label) {
  SLX_ASSIGN_OR_RETURN(const auto all, TrainingLightsOf(srds, kNoneHeldOut));
  EmOptions em = OnThinnedCycles(OnPools(options.em, srds.pool), srds);
  em.scattering = fit.map.scattering;
  em.prior.photons = fit.map.prior_photons;
  std::vector<LayerSet> mean;
  if (HasMeanLayers(options)) {
    SLX_ASSIGN_OR_RETURN(mean, MeanLayers(all.batches, srds.channels, em));
  }
  const bool neighbours = fit.map.session_photons > 0.0 && !mean.empty() && srds.spacing_mm > 0.0;
  ProfileLayers near;
  if (neighbours) {
    EmOptions by_session = em;
    by_session.prior.photons = fit.map.session_photons;
    SLX_ASSIGN_OR_RETURN(near, FitNeighbours(all.batches, all.projectors, srds.width, srds.height, srds.channels,
                                             by_session, mean, srds.spacing_mm));
  }
  const double of_mean = fit.map.session_photons;
  const StartLayers start = neighbours ? StartLayers(mean, &near, of_mean) : StartLayers(mean);
  RefinedLayers refined;
  MapsFigures& figures = refined.figures;
  figures.heldout = heldout;
  SLX_ASSIGN_OR_RETURN(figures.warm, ChooseWarmSweeps(all.batches, all.projectors, fit.map, em, start));
  logger.Info(label + ": " + Describe(figures.warm));
  if (figures.warm.profiles > 0 && !figures.warm.Reached())
    logger.Info(label +
                Formatted(": as many as the fit takes, for %.3f nats were not reached by fewer", kWarmToleranceNats));
  Progress progress(logger, label, fit.map.profiles());
  SLX_ASSIGN_OR_RETURN(
      auto made, RefineMixture(all.batches, all.projectors, std::move(fit.map), std::max(figures.warm.sweeps, 1), em,
                               start, [&](int64_t done) { progress.Advance(done); }));
  figures.refined = made.refined;
  figures.kept = made.kept;
  figures.added = made.added;
  figures.unusable = made.unusable;
  figures.projectors = DistinctProjectors(made.map);
  figures.provenance = ProvenanceOf(made.map, static_cast<int>(srds.batches.size()));
  figures.divergence = MedianDivergence(made.map);
  refined.layers.pool = srds.pool;
  refined.layers.signal_to_noise = RefinedSignalToNoise(made, all.batches, fit.signal_to_noise);
  refined.layers.map = std::move(made.map);
  return refined;
}

Status SaveMaps(const std::filesystem::path& folder, const RefinedLayers& refined) {
  const std::filesystem::path maps = folder / kMapsFolder;
  std::error_code error;
  std::filesystem::create_directory(maps, error);
  if (error) return Status::Failed("cannot create " + maps.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SaveLayers(maps, refined.layers));
  SLX_RETURN_IF_ERROR(WriteLayerMaps(maps, SummariseLayers(refined.layers.map)));
  const MapsFigures& f = refined.figures;
  nlohmann::ordered_json trials = nlohmann::ordered_json::array();
  for (const auto& trial : f.warm.trials)
    trials.push_back(
        {{"sweeps", trial.sweeps}, {"excess_nats", trial.excess_nats}, {"cold_excess_nats", trial.cold_excess_nats}});
  return WriteJson(
      maps / "maps.json",
      {{"schema", 1},
       {"provenance", f.provenance},
       {"projectors", f.projectors},
       {"heldout_of_fit", f.heldout},
       {"warm_start",
        {{"sweeps", f.warm.sweeps},
         {"tolerance_nats", kWarmToleranceNats},
         {"trials", trials},
         {"cold_sweeps", f.warm.cold_sweeps},
         {"cold_excess_nats", f.warm.cold_nats},
         {"referee_sweeps", f.warm.referee_sweeps},
         {"seed", kWarmSeed},
         {"profiles", f.warm.profiles}}},
       {"profiles",
        {{"refined", f.refined}, {"kept", f.kept}, {"added", f.added}, {"heldout_light_unusable", f.unusable}}},
       {"divergence", f.divergence}});
}

Result<FittedLayers> LoadMaps(const std::filesystem::path& folder) { return LoadLayers(folder / kMapsFolder); }

Result<MapsFigures> LoadMapsFigures(const std::filesystem::path& folder) {
  MapsFigures f;
  int schema = 0;
  const std::filesystem::path file = folder / kMapsFolder / "maps.json";
  SLX_RETURN_IF_ERROR(ReadJson(file, [&](const nlohmann::json& json) {
    if (json.at("schema").get_to(schema) > 1) return;
    json.at("provenance").get_to(f.provenance);
    json.at("projectors").get_to(f.projectors);
    json.at("heldout_of_fit").get_to(f.heldout);
    const auto& warm = json.at("warm_start");
    warm.at("sweeps").get_to(f.warm.sweeps);
    for (const auto& trial : warm.at("trials"))
      f.warm.trials.push_back({trial.at("sweeps"), trial.at("excess_nats"), trial.at("cold_excess_nats")});
    warm.at("cold_sweeps").get_to(f.warm.cold_sweeps);
    warm.at("cold_excess_nats").get_to(f.warm.cold_nats);
    warm.at("referee_sweeps").get_to(f.warm.referee_sweeps);
    warm.at("profiles").get_to(f.warm.profiles);
    const auto& profiles = json.at("profiles");
    profiles.at("refined").get_to(f.refined);
    profiles.at("kept").get_to(f.kept);
    profiles.at("added").get_to(f.added);
    profiles.at("heldout_light_unusable").get_to(f.unusable);
    json.at("divergence").get_to(f.divergence);
  }));
  if (schema > 1)
    return Status(StatusCode::kNewerSchema,
                  file.string() + ": schema " + std::to_string(schema) + ", this program reads up to 1");
  return f;
}

}  // namespace stratalux::fit
