// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/fit_mixture.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "fitter/mixture/em_block.h"
#include "fitter/mixture/em_tasks.h"
#include "shared/base/check.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

MixtureMap EmptyMap(int width, int height, int channels, const EmOptions& options, const std::vector<int>& projectors) {
  MixtureMap map;
  map.width = width;
  map.height = height;
  map.channels = channels;
  map.layers = options.layers;
  map.scattering = options.scattering;
  map.training_projectors = projectors;
  const size_t profiles = static_cast<size_t>(map.profiles());
  for (auto* v : {&map.weight, &map.depth_mm, &map.sigma_mm}) v->assign(profiles * options.layers, 0.0F);
  std::fill(map.sigma_mm.begin(), map.sigma_mm.end(), 1.0F);
  map.surface.assign(profiles * projectors.size(), 0.0F);
  map.background.assign(profiles * projectors.size(), 0.0F);
  map.divergence.assign(profiles, 0.0F);
  map.iterations.assign(profiles, 0);
  map.reason.assign(profiles, static_cast<uint8_t>(FitReason::kNoProjector));
  return map;
}

// Profiles of one task of ParallelFor: enough that lanes seldom run empty at its end.
constexpr size_t kTask = 256;

// work(block, profiles), from several threads, for all usable profiles: a block for those that may share it.
template <typename Work>
void ForEachTask(std::span<const SrdBatch* const> lights, const Judgement& judged, int channels,
                 const EmOptions& options, const StartLayers& start, const Work& work) {
  const EmTasks tasks = TasksOf(lights, judged, channels, options, kTask);
  ParallelEach(tasks.size(), [&](size_t t) {
    EmBlock em(lights, judged.usable, tasks.cells_per_sample(t), options, start);
    work(em, tasks.profiles(t));
  });
}

// Runs EM on all usable profiles with each of `photons`; `done(block, lane, profile, trial)` and `progress(profiles)`,
// once a task, are called from several threads. `trace`: of the first `traced` sweeps (EmBlock::TraceCosts).
template <typename Done>
void ForEachProfile(std::span<const SrdBatch* const> lights, const Judgement& judged, int channels,
                    const EmOptions& options, const StartLayers& start, std::span<const double> photons,
                    const std::function<void(int64_t)>& progress, const Done& done, int traced = 0,
                    const std::function<void(int64_t, int, double)>& trace = {}) {
  ForEachTask(lights, judged, channels, options, start, [&](EmBlock& em, std::span<const int64_t> profiles) {
    em.TraceCosts(traced, trace);
    em.Fit(profiles, photons, [&](int lane, int64_t profile, size_t trial) { done(em, lane, profile, trial); });
    if (progress) progress(static_cast<int64_t>(profiles.size()));
  });
}

// What the lane has found of the profile, but for the figures of the fit.
void TakeLayers(const EmBlock& em, int lane, int64_t i, const EmOptions& options, MixtureMap& map) {
  for (int l = 0; l < options.layers; ++l) {
    map.weight[i * options.layers + l] = em.Weight(l, lane);
    map.depth_mm[i * options.layers + l] = em.DepthMm(l, lane);
    map.sigma_mm[i * options.layers + l] = em.SigmaMm(l, lane);
  }
  const size_t lights = map.training_projectors.size();
  for (size_t p = 0; p < lights; ++p) {
    map.surface[i * lights + p] = em.Surface(static_cast<int>(p), lane);
    map.background[i * lights + p] = em.Background(static_cast<int>(p), lane);
  }
  if (options.scattering.mode == FitMode::kTied && em.LargestShift(lane) < 0.02F)
    map.reason[i] = static_cast<uint8_t>(FitReason::kDepthNotEstimable);
}

// All that the lane has found.
void TakeFit(const EmBlock& em, int lane, int64_t i, const EmOptions& options, MixtureMap& map) {
  TakeLayers(em, lane, i, options, map);
  map.divergence[i] = static_cast<float>(em.Divergence(lane));
  if (!map.prior_share.empty()) map.prior_share[i] = static_cast<float>(em.PriorShare(lane));
  map.iterations[i] = static_cast<uint16_t>(std::min(em.Sweeps(lane), 65535));
}

Status CheckFit(std::span<const SrdBatch* const> lights, int64_t profiles, int channels, const EmOptions& options,
                const StartLayers& start) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_CHECK(start.empty() || static_cast<int>(start.mean.size()) == channels);
  return CheckLights(lights, profiles);
}

}  // namespace

Status EmOptions::Validate() const {
  if (layers < 1 || layers > 32) return Status::Usage("layers = " + std::to_string(layers) + ", allowed: 1 .. 32");
  if (const double eta = scattering.eta; !(eta >= 1.0 && eta <= 3.0))
    return Status::Usage("eta = " + std::to_string(eta) + ", allowed: 1 .. 3");
  if (max_iterations < 1 || max_iterations > 100000)
    return Status::Usage("max_iterations = " + std::to_string(max_iterations) + ", allowed: 1 .. 100000");
  if (refinement_iterations < 0 || refinement_iterations > 100000)
    return Status::Usage("refinement_iterations = " + std::to_string(refinement_iterations) + ", allowed: 0 .. 100000");
  if (!(prior.photons >= 0.0 && prior.photons <= kMostPriorPhotons))
    return Status::Usage("a prior of " + std::to_string(prior.photons) + " photons, allowed: 0 .. 1e7");
  if (!(prior.square_shift >= 0.0 && prior.square_shift <= 1e4))
    return Status::Usage("prior: square_shift = " + std::to_string(prior.square_shift) + ", allowed: 0 .. 1e4");
  if (!(tolerance >= 0.0)) return Status::Usage("tolerance must not be negative");
  if (cells_per_sample < 1 || cells_per_sample > 64) return Status::Usage("cells_per_sample must lie in 1 .. 64");
  return Status::Ok();
}

Result<TracedFit> FitTraced(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int width,
                            int height, int channels, const EmOptions& options, const StartLayers& start, int traced,
                            const std::function<void(int64_t)>& progress) {
  const int64_t profiles = int64_t{width} * height * channels;
  SLX_RETURN_IF_ERROR(CheckFit(lights, profiles, channels, options, start));
  TracedFit fit{EmptyMap(width, height, channels, options, projectors), {}, {}};
  MixtureMap& map = fit.map;
  Judgement judged = JudgeAll(lights);
  map.reason = std::move(judged.reason);
  if (!start.empty() && options.prior.photons > 0.0) {
    map.prior_photons = options.prior.photons;
    map.prior_share.assign(static_cast<size_t>(profiles), 0.0F);
  }
  fit.cost.assign(static_cast<size_t>(profiles), std::nanf(""));
  fit.cost_after.assign(static_cast<size_t>(profiles) * static_cast<size_t>(traced), std::nanf(""));
  ForEachProfile(
      lights, judged, channels, options, start, {&options.prior.photons, 1}, progress,
      [&](const EmBlock& em, int lane, int64_t i, size_t /*trial*/) {
        TakeFit(em, lane, i, options, map);
        fit.cost[i] = static_cast<float>(em.Cost(lane));
        for (int s = em.Sweeps(lane); s < traced; ++s) fit.cost_after[i * traced + s] = fit.cost[i];
      },
      traced,
      [&](int64_t i, int swept, double cost) { fit.cost_after[i * traced + swept - 1] = static_cast<float>(cost); });
  return fit;
}

Result<MixtureMap> FitMixture(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int width,
                              int height, int channels, const EmOptions& options, const StartLayers& start,
                              const std::function<void(int64_t)>& progress) {
  SLX_ASSIGN_OR_RETURN(TracedFit fit,
                       FitTraced(lights, projectors, width, height, channels, options, start, 0, progress));
  return std::move(fit.map);
}

Result<ProfileLayers> FitNeighbours(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                    int width, int height, int channels, const EmOptions& options,
                                    std::span<const LayerSet> mean, double spacing_mm,
                                    const std::function<void(int64_t)>& progress) {
  EmOptions first = options;
  first.prior.photons *= kFirstShare;
  SLX_ASSIGN_OR_RETURN(const MixtureMap fit,
                       FitMixture(lights, projectors, width, height, channels, first, mean, progress));
  return NeighbourLayers(fit, lights[0]->apart, mean, spacing_mm);
}

Result<MixtureMap> FitAmongNeighbours(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                      int width, int height, int channels, const EmOptions& options,
                                      std::span<const LayerSet> mean, double spacing_mm, double photons,
                                      const std::function<void(int64_t)>& progress) {
  EmOptions second = options;
  second.prior.photons = photons;
  SLX_ASSIGN_OR_RETURN(const ProfileLayers near,
                       FitNeighbours(lights, projectors, width, height, channels, options, mean, spacing_mm, progress));
  SLX_ASSIGN_OR_RETURN(MixtureMap map, FitMixture(lights, projectors, width, height, channels, second,
                                                  {mean, &near, options.prior.photons}, progress));
  map.session_photons = options.prior.photons;
  return map;
}

Result<std::vector<MixtureMap>> FitWithPriors(std::span<const SrdBatch* const> lights,
                                              const std::vector<int>& projectors, int channels,
                                              const EmOptions& options, const StartLayers& start,
                                              std::span<const double> photons) {
  if (lights.empty()) return Status::Usage("EM needs at least one light");
  SLX_CHECK(!photons.empty());
  const int64_t profiles = lights[0]->profiles();
  SLX_RETURN_IF_ERROR(CheckFit(lights, profiles, channels, options, start));
  const Judgement judged = JudgeAll(lights);
  std::vector<MixtureMap> maps(photons.size(),
                               EmptyMap(static_cast<int>(profiles / channels), 1, channels, options, projectors));
  for (MixtureMap& map : maps) map.reason = judged.reason;
  ForEachProfile(
      lights, judged, channels, options, start, photons, {},
      [&](const EmBlock& em, int lane, int64_t i, size_t trial) { TakeLayers(em, lane, i, options, maps[trial]); });
  return maps;
}

std::vector<std::vector<double>> DivergencesFrom(std::span<const MixtureMap> fits, const SrdBatch& light, int channels,
                                                 const EmOptions& options) {
  const SrdBatch* const lights[] = {&light};
  const Judgement judged = JudgeAll(lights);
  std::vector<std::vector<double>> divergence(fits.size(),
                                              std::vector<double>(static_cast<size_t>(light.profiles()), std::nan("")));
  ForEachTask(lights, judged, channels, options, {}, [&](EmBlock& em, std::span<const int64_t> profiles) {
    em.CompareWith(profiles, fits, [&](int64_t i, size_t fit, double photons) {
      if (fits[fit].Fitted(i)) divergence[fit][i] = photons;
    });
  });
  return divergence;
}

double EstimateTau(std::span<const SrdBatch* const> lights, double eta, const SurfaceReflection& surface) {
  // Centre each profile's values over its lights, then one regression through the origin.
  constexpr int64_t kRun = 4096;  // profiles whose sums are made together, on however many threads
  const int64_t profiles = lights.empty() ? 0 : lights[0]->profiles();
  struct Sums {
    double xy = 0.0, xx = 0.0;
  };
  std::vector<Sums> runs(static_cast<size_t>((profiles + kRun - 1) / kRun));
  const auto add = [&](int64_t i, Sums& sums) {
    std::vector<double> x, y;
    for (const SrdBatch* batch : lights) {
      if (batch->IsApart(i) || JudgeProfile(*batch, i) != FitReason::kFitted || batch->cos_in[i] < 0.4F) continue;
      const double sum = WhiteReflectanceOf(*batch, i).value - ReflectedBy(surface, *batch, i, eta);
      if (!(sum > 0.0)) continue;
      const double cos_in = batch->cos_in[i];
      x.push_back(GainPath(cos_in, eta));
      y.push_back(std::log(sum / AngularGain(cos_in, eta, 0.0)));
    }
    if (x.size() < 2) return;
    double mx = 0.0, my = 0.0;
    for (size_t k = 0; k < x.size(); ++k) {
      mx += x[k] / static_cast<double>(x.size());
      my += y[k] / static_cast<double>(x.size());
    }
    for (size_t k = 0; k < x.size(); ++k) {
      // Highlights and shadows are outliers: bounded influence.
      const double dy = std::clamp(y[k] - my, -0.3, 0.3);
      sums.xy += (x[k] - mx) * dy;
      sums.xx += (x[k] - mx) * (x[k] - mx);
    }
  };
  ParallelEach(runs.size(), [&](size_t run) {
    const int64_t first = static_cast<int64_t>(run) * kRun;
    for (int64_t i = first; i < std::min(first + kRun, profiles); ++i) add(i, runs[run]);
  });
  Sums all;
  for (const Sums& run : runs) {
    all.xy += run.xy;
    all.xx += run.xx;
  }
  return all.xx > 1e-6 ? std::clamp(-all.xy / all.xx, -1.0, 3.0) : 0.0;
}

}  // namespace stratalux::fit
