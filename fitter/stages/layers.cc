// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/layers.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include <nlohmann/json.hpp>

#include "fitter/mixture/choose_prior.h"
#include "fitter/mixture/choose_sweeps.h"
#include "fitter/mixture/em_light.h"
#include "fitter/mixture/estimate_directions.h"
#include "fitter/mixture/free_fit.h"
#include "fitter/mixture/mean_layers.h"
#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

using Lights = std::vector<const SrdBatch*>;

std::string Describe(const ScatteringModel& model) {
  std::ostringstream text;
  text.precision(3);
  text << "tau " << model.tau << ", surface ";
  if (model.reflection.Known())
    text << model.reflection.strength << " of Fresnel's, roughness " << model.reflection.roughness;
  else
    text << "each light's own";
  if (const auto& gloss = model.reflection.gloss.nodes; !gloss.empty())
    text << ", gloss up to " << *std::ranges::max_element(gloss);
  return text.str();
}

std::string Describe(const DirectionEstimate& chosen) {
  std::ostringstream text;
  text << "tau " << chosen.tau << ", kappa " << chosen.weights.kappa_per_mm << " / mm, phase slope "
       << chosen.weights.phase_slope << ", sigma_0 " << chosen.weights.sigma_0_mm << " mm; training divergence "
       << chosen.divergence << ", without " << chosen.divergence_without;
  return text.str();
}

std::string Describe(const PriorChoice& choice) {
  std::ostringstream text;
  text << "prior of " << choice.prior.photons << " photons per profile";
  for (const auto& trial : choice.trials)
    text << (&trial == &choice.trials.front() ? "; divergence of the lights, each left out in turn: " : ", ")
         << trial.divergence << " with " << trial.photons;
  return text.str();
}

std::string Describe(const SweepChoice& choice) {
  if (choice.profiles == 0) return "no profile that can be fitted";
  return Formatted("%d sweeps from the mean layers, %.3f nats per profile above converged EM", choice.sweeps,
                   choice.trials.back().excess_nats);
}

std::string Describe(const NeighboursChoice& choice) {
  if (choice.trials.empty()) return "prior of the session's mean layers: too little data to try the neighbours'";
  std::ostringstream text;
  if (choice.photons > 0.0)
    text << "prior of " << choice.photons << " photons of a profile's neighbours";
  else
    text << "prior of the session's mean layers, which predict as well as neighbours";
  for (const auto& trial : choice.trials)
    text << (&trial == &choice.trials.front() ? "; nats per profile of the lights left out, relative to the "
                                                "session's mean: "
                                              : ", ")
         << trial.more_nats << " with " << trial.photons;
  return text.str();
}

constexpr int kMostSweeps = 100000;

// Of EmOptions::tolerance, for the mean layers that a session's pixels start from. A thousand profiles have some 2e4
// nats of divergence, so that a sweep still gains a fiftieth of a nat; noise costs half a nat for each number that they
// tell. Settled by ten times as much, dim light would keep the wide layers that EM starts from (docs/math/em.md). No
// light that is left out tells the one from the other.
constexpr double kToleranceOfMean = 0.1;
// Of EmOptions::max_iterations, for the same: they settle after 50 to 200 sweeps.
constexpr int kTimesTheSweepsOfMean = 5;

// Fits that are asked for fewer sweeps than EmOptions has stay quick; `asked`: before pools and thinned cycles.
EmOptions ForMeanLayers(EmOptions em, int asked) {
  if (asked < EmOptions().max_iterations) return em;
  em.tolerance *= kToleranceOfMean;
  em.max_iterations = std::min(kTimesTheSweepsOfMean * em.max_iterations, kMostSweeps);
  return em;
}

int64_t UsableProfiles(const Lights& lights) {
  int64_t usable = 0;
  for (int64_t i = 0; i < lights[0]->profiles(); ++i)
    usable += std::any_of(lights.begin(), lights.end(), [i](const SrdBatch* b) { return b->valid[i] != 0; }) ? 1 : 0;
  return usable;
}

bool MayHaveNeighbours(const FitOptions& options) {
  return options.choose.neighbours && HasMeanLayers(options) && options.em.scattering.mode == FitMode::kTied;
}

}  // namespace

std::string FitOptionsJson(const FitOptions& options) {
  const EmOptions& o = options.em;
  const ScatteringModel& model = o.scattering;
  const nlohmann::json json = {{"layers", o.layers},
                               {"mode", model.mode == FitMode::kTied ? "tied" : "free"},
                               {"shift_law", ToString(model.shift_law)},
                               {"eta", model.eta},
                               {"gain_model", model.gain_model},
                               {"choose_directions", options.choose.directions},
                               {"direction_blind", o.direction_blind},
                               {"surface_term", o.surface_term},
                               {"estimate_reflection", options.choose.reflection},
                               {"background_term", o.background_term},
                               {"shared_background", o.shared_background},
                               {"max_iterations", o.max_iterations},
                               {"refinement_iterations", o.refinement_iterations},
                               {"prior_photons", o.prior.photons},
                               {"prior_square_shift", o.prior.square_shift},
                               {"choose_prior", options.choose.prior},
                               {"neighbours", MayHaveNeighbours(options)},
                               {"tolerance", o.tolerance},
                               {"accelerated", o.accelerated},
                               {"cells_per_sample", o.cells_per_sample},
                               {"min_sigma_mm", o.min_sigma_mm},
                               {"max_sigma_mm", o.max_sigma_mm},
                               {"max_cell_mm", o.max_cell_mm},
                               {"min_depth_mm", o.min_depth_mm},
                               {"max_depth_mm", o.max_depth_mm}};
  return json.dump();
}

bool HasMeanLayers(const FitOptions& options) { return options.choose.prior || options.em.prior.photons > 0.0; }

EmOptions OnPools(EmOptions em, int pool) {
  em.max_iterations = static_cast<int>(std::min<int64_t>(int64_t{em.max_iterations} * pool * pool, kMostSweeps));
  return em;
}

EmOptions OnThinnedCycles(EmOptions em, const SrdSet& srds) {
  double apart = 1.0;
  for (const SrdBatch& batch : srds.batches)
    for (int64_t i = 0; i < batch.profiles(); ++i) {
      if (batch.valid[i] == 0) continue;
      if (IsThinned(batch, i)) apart = std::max(apart, double{batch.step_mm[i]} / batch.line_width_mm[i]);
      break;  // the comb is that of all profiles
    }
  if (!(apart > 1.0)) return em;
  const int times = 2 * static_cast<int>(std::lround(apart));
  em.max_iterations = std::min(em.max_iterations * times, kMostSweeps);
  em.refinement_iterations = std::min(em.refinement_iterations * times, kMostSweeps);
  return em;
}

Result<TrainingLights> TrainingLightsOf(const SrdSet& srds, int heldout) {
  TrainingLights lights;
  for (const auto* batches : {&srds.batches, &srds.row_batches})
    for (int p = 0; p < static_cast<int>(batches->size()); ++p) {
      if (p == heldout) continue;
      lights.batches.push_back(&(*batches)[p]);
      lights.projectors.push_back(p);
    }
  if (lights.batches.empty())
    return Status::Usage("with projector " + std::to_string(heldout) +
                         " held out no light is left to fit: the layers need sweeps of at least two projectors");
  return lights;
}

SharedLight FindSharedLight(const FitOptions& options, const Lights& lights, const ProfileGrid& grid) {
  const ScatteringModel& model = options.em.scattering;
  SharedLight shared;
  if (options.em.surface_term && options.choose.reflection)
    shared.reflection = EstimateSurfaceReflection(lights, grid, model.eta);
  shared.tau = model.gain_model ? EstimateTau(lights, model.eta, shared.reflection) : model.tau;
  return shared;
}

Result<EmOptions> SharedOptions(const FitOptions& options, const Lights& lights, const SrdSet& srds,
                                const SharedLight& shared, Logger& logger, const std::string& label) {
  EmOptions em = OnThinnedCycles(OnPools(options.em, srds.pool), srds);
  ScatteringModel& model = em.scattering;
  model.reflection = shared.reflection;
  model.tau = shared.tau;
  if (em.surface_term && options.choose.reflection && !model.reflection.Known())
    logger.Warning(label +
                   ": too few pixels are lit from two directions within 60 degrees to tell how the surface itself "
                   "reflects; each light gets its own reflection, as with --surface free");
  logger.Info(label + ": " + Describe(model));
  if (options.choose.directions && model.mode == FitMode::kTied && !em.direction_blind) {
    SLX_ASSIGN_OR_RETURN(const auto chosen, EstimateDirections(lights, srds.channels, em));
    model.tau = chosen.tau;
    model.directional = chosen.weights;
    logger.Info(label + ": " + Describe(chosen));
  }
  return em;
}

Result<MixtureMap> FitLayers(const SrdSet& srds, int heldout, const FitOptions& options, Logger& logger,
                             const std::string& label) {
  SLX_ASSIGN_OR_RETURN(const auto training, TrainingLightsOf(srds, heldout));
  return FitLayers(srds, heldout, options, FindSharedLight(options, training.batches, srds.Grid()), logger, label);
}

Result<MixtureMap> FitLayers(const SrdSet& srds, int heldout, const FitOptions& options, const SharedLight& shared,
                             Logger& logger, const std::string& label) {
  SLX_ASSIGN_OR_RETURN(const auto training, TrainingLightsOf(srds, heldout));
  const auto& [lights, projectors] = training;
  SLX_ASSIGN_OR_RETURN(EmOptions em, SharedOptions(options, lights, srds, shared, logger, label));
  const bool free = em.scattering.mode == FitMode::kFree;
  std::vector<LayerSet> start;
  LeftOutLights left;
  if (HasMeanLayers(options)) {
    EmOptions tied = em;  // the session's mean layers, which all pixels start from, are those of all lights
    tied.scattering.mode = FitMode::kTied;
    SLX_ASSIGN_OR_RETURN(start, MeanLayers(lights, srds.channels, ForMeanLayers(tied, options.em.max_iterations)));
    if (options.choose.prior || MayHaveNeighbours(options)) {
      SLX_ASSIGN_OR_RETURN(left, LeaveOutEach(lights, projectors, srds.channels, tied));
    }
    if (options.choose.prior) {
      SLX_ASSIGN_OR_RETURN(const auto choice, ChoosePrior(left, tied));
      em.prior = choice.prior;
      logger.Info(label + ": " + Describe(choice));
    }
  }
  const bool neighbours = MayHaveNeighbours(options) && em.prior.photons > 0.0 && srds.spacing_mm > 0.0;
  if (!start.empty() && !free) {
    EmOptions slowest = em;  // a weaker prior asks for more
    if (neighbours) slowest.prior.photons *= kFirstShare;
    SLX_ASSIGN_OR_RETURN(const auto choice, ChooseSweeps(lights, projectors, srds.channels, slowest, start));
    logger.Info(label + ": " + Describe(choice));
    if (choice.profiles > 0) em.refinement_iterations = choice.sweeps;
  }
  double of_neighbours = 0.0;  // photons
  if (neighbours) {
    SLX_ASSIGN_OR_RETURN(const auto choice,
                         ChooseNeighboursPrior(lights, left, srds.width, srds.height, em, srds.spacing_mm));
    logger.Info(label + ": " + Describe(choice));
    of_neighbours = choice.photons;
  }
  const int64_t fits = UsableProfiles(lights) * (free                  ? static_cast<int64_t>(lights.size())
                                                 : of_neighbours > 0.0 ? 2
                                                                       : 1);
  Progress progress(logger, label, fits);
  const auto advance = [&](int64_t done) { progress.Advance(done); };
  if (free) return FitFree(lights, projectors, srds.width, srds.height, srds.channels, em, start, advance);
  if (of_neighbours > 0.0)
    return FitAmongNeighbours(lights, projectors, srds.width, srds.height, srds.channels, em, start, srds.spacing_mm,
                              of_neighbours, advance);
  return FitMixture(lights, projectors, srds.width, srds.height, srds.channels, em, start, advance);
}

}  // namespace stratalux::fit
