// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/fit_mixture.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include "fitter/mixture/em_block.h"
#include "fitter/mixture/fine_grid.h"
#include "fitter/mixture/line_response.h"
#include "fitter/mixture/photon_noise.h"
#include "shared/base/check.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

// Beyond, single precision would overflow somewhere in a sweep; no reflectance, no millimetre is that large.
bool Usable(float value) { return std::abs(value) < 1e9F; }

bool GeometryUsable(const SrdBatch& batch, int64_t i) {
  for (float v : {batch.first_u_mm[i], batch.line_width_mm[i], batch.blur_mm[i], batch.slope_in[i], batch.slope_out[i],
                  batch.slope_in_across[i], batch.slope_out_across[i], batch.cos_in[i]})
    if (!Usable(v)) return false;
  if (!Usable(static_cast<float>(SampleSitesOf(batch, i).ReachMm()))) return false;
  if (!batch.white.empty() && !(Usable(batch.white[i]) && Usable(batch.white_variance[i]))) return false;
  const float step = batch.step_mm[i];
  return step > 1e-6F && step < 1e6F && batch.line_width_mm[i] >= 0.0F && batch.blur_mm[i] >= 0.0F;
}

// A profile is usable when its samples are finite, not constant, and add up to light.
FitReason Judge(const SrdBatch& batch, int64_t profile) {
  if (batch.valid[profile] == 0) return FitReason::kNoProjector;
  const auto y = batch.Samples(profile);
  double sum = 0.0;
  float low = y[0], high = y[0];
  for (int k = 0; k < batch.samples; ++k) {
    if (!Usable(y[k])) return FitReason::kNotFinite;
    sum += y[k];
    low = std::min(low, y[k]);
    high = std::max(high, y[k]);
  }
  for (const float noise : {batch.noise_floor[profile], batch.noise_slope[profile]})
    if (!Usable(noise) || !(noise >= 0.0F)) return FitReason::kNotFinite;
  const PhotonNoise photons = PhotonNoiseOf(batch, profile);
  if (!Usable(static_cast<float>(photons.counts)) || !Usable(static_cast<float>(photons.read_shift)))
    return FitReason::kNotFinite;
  if (!GeometryUsable(batch, profile)) return FitReason::kNotFinite;
  if (!(batch.cos_in[profile] > 1e-3F)) return FitReason::kNoProjector;  // from behind the horizon
  return sum > 0.0 && high > low && high > 1e-9F ? FitReason::kFitted : FitReason::kTooDark;
}

Status CheckBatches(std::span<const SrdBatch* const> lights, int64_t profiles) {
  if (lights.empty()) return Status::Usage("EM needs at least one light");
  for (const SrdBatch* batch : lights) {
    if (batch->profiles() != profiles)
      return Status::Failed("EM: a light has " + std::to_string(batch->profiles()) + " profiles, expected " +
                            std::to_string(profiles));
    if (batch->samples < 3)
      return Status::Usage("EM: a profile needs at least 3 samples, not " + std::to_string(batch->samples));
  }
  return Status::Ok();
}

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

// Every light of every profile judged once.
struct Judgement {
  std::vector<std::vector<uint8_t>> usable;  // [light][profile]
  std::vector<uint8_t> reason;               // [profile] FitReason
  std::vector<int64_t> work;                 // profiles that some light can fit
};

Judgement JudgeAll(std::span<const SrdBatch* const> lights) {
  const int64_t profiles = lights[0]->profiles();
  Judgement judged{
      std::vector(lights.size(), std::vector<uint8_t>(profiles, 0)), std::vector<uint8_t>(profiles, 0), {}};
  for (int64_t i = 0; i < profiles; ++i) {
    FitReason worst = FitReason::kNoProjector;
    bool any = false;
    for (size_t p = 0; p < lights.size(); ++p) {
      const FitReason reason = Judge(*lights[p], i);
      judged.usable[p][i] = reason == FitReason::kFitted ? 1 : 0;
      any = any || judged.usable[p][i] != 0;
      if (reason != FitReason::kNoProjector && reason != FitReason::kFitted) worst = reason;
    }
    judged.reason[i] = static_cast<uint8_t>(any ? FitReason::kFitted : worst);
    if (any) judged.work.push_back(i);
  }
  return judged;
}

// Profiles of one task of ParallelFor: enough that lanes seldom run empty at its end.
constexpr size_t kTask = 256;

// Profiles that share the grids of their lights, and may share a block.
struct Task {
  std::vector<int> cells_per_sample;  // [light]
  std::span<const int64_t> profiles;
};

// `work` sorted by grids, then by channel (like layers meet in a block), and cut into tasks.
std::vector<Task> TasksOf(std::span<const SrdBatch* const> lights, const Judgement& judged, int channels,
                          const EmOptions& options, std::vector<int64_t>& work) {
  std::map<std::vector<int>, size_t> known;
  std::vector<std::vector<int>> grids;  // distinct ones
  std::vector<std::pair<size_t, int64_t>> keys;
  std::vector<int> grid(lights.size());
  for (int64_t i : judged.work) {
    for (size_t p = 0; p < lights.size(); ++p)
      grid[p] = judged.usable[p][i] != 0 ? CellsPerSample(*lights[p], i, options) : 1;
    const auto [at, is_new] = known.emplace(grid, grids.size());
    if (is_new) grids.push_back(grid);
    keys.emplace_back(at->second * channels + static_cast<size_t>(i % channels), i);
  }
  std::sort(keys.begin(), keys.end());
  work.clear();
  for (const auto& [key, i] : keys) work.push_back(i);
  std::vector<Task> tasks;
  for (size_t begin = 0; begin < keys.size();) {
    const size_t of_grid = keys[begin].first / channels;
    size_t end = begin;
    while (end < keys.size() && end - begin < kTask && keys[end].first / channels == of_grid) ++end;
    tasks.push_back({grids[of_grid], std::span(work).subspan(begin, end - begin)});
    begin = end;
  }
  return tasks;
}

// work(block, profiles), from several threads, for all usable profiles: a block for those that may share it.
template <typename Work>
void ForEachTask(std::span<const SrdBatch* const> lights, const Judgement& judged, int channels,
                 const EmOptions& options, const StartLayers& start, const Work& work) {
  std::vector<int64_t> order;
  const std::vector<Task> tasks = TasksOf(lights, judged, channels, options, order);
  ParallelEach(tasks.size(), [&](size_t t) {
    EmBlock em(lights, judged.usable, tasks[t].cells_per_sample, options, start);
    work(em, tasks[t].profiles);
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
  return CheckBatches(lights, profiles);
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

Result<std::vector<LayerSet>> MeanLayers(std::span<const SrdBatch* const> lights, int channels,
                                         const EmOptions& options, int every) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_CHECK(every >= 1);
  if (lights.empty()) return Status::Usage("EM needs at least one light");
  SLX_RETURN_IF_ERROR(CheckBatches(lights, lights[0]->profiles()));
  Judgement judged = JudgeAll(lights);
  // Every so many pixels, all channels of each.
  std::erase_if(judged.work, [&](int64_t i) { return i / channels % every != 0 || lights[0]->IsApart(i); });
  // Layers by profile, so that the sums do not depend on the order in which blocks finish.
  const size_t layers = static_cast<size_t>(options.layers);
  const size_t stride = 3 * layers + 1;
  std::vector<float> fitted(judged.work.size() * stride);
  std::vector<int64_t> place(static_cast<size_t>(lights[0]->profiles()), -1);
  for (size_t k = 0; k < judged.work.size(); ++k) place[judged.work[k]] = static_cast<int64_t>(k);
  const double no_prior[] = {0.0};
  ForEachProfile(lights, judged, channels, options, {}, no_prior, {},
                 [&](const EmBlock& em, int lane, int64_t i, size_t /*trial*/) {
                   float* profile = fitted.data() + place[i] * stride;
                   for (size_t l = 0; l < layers; ++l) {
                     profile[3 * l] = em.Weight(static_cast<int>(l), lane);
                     profile[3 * l + 1] = em.DepthMm(static_cast<int>(l), lane);
                     profile[3 * l + 2] = em.SigmaMm(static_cast<int>(l), lane);
                   }
                   profile[3 * layers] = em.MeanBackground(lane);
                 });
  std::vector<LayerSet> mean(channels);
  std::vector<int64_t> count(channels, 0);
  for (size_t k = 0; k < judged.work.size(); ++k) {
    const size_t c = static_cast<size_t>(judged.work[k] % channels);
    LayerSet& set = mean[c];
    for (auto* v : {&set.weight, &set.depth_mm, &set.sigma_mm}) v->resize(layers, 0.0);
    ++count[c];
    for (size_t l = 0; l < layers; ++l) {
      const float* at = fitted.data() + k * stride + 3 * l;
      set.weight[l] += at[0];
      set.depth_mm[l] += double(at[0]) * at[1];
      set.sigma_mm[l] += double(at[0]) * at[2];
    }
    set.background += fitted[k * stride + 3 * layers];
  }
  for (int c = 0; c < channels; ++c) {
    if (count[c] == 0) continue;
    mean[c].background /= static_cast<double>(count[c]);
    for (size_t l = 0; l < mean[c].weight.size(); ++l) {
      const double w = mean[c].weight[l];
      mean[c].depth_mm[l] = w > 0.0 ? mean[c].depth_mm[l] / w : 0.0;
      mean[c].sigma_mm[l] = w > 0.0 ? mean[c].sigma_mm[l] / w : 1.0;
      mean[c].weight[l] /= static_cast<double>(count[c]);
    }
  }
  return mean;
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
      if (batch->IsApart(i) || Judge(*batch, i) != FitReason::kFitted || batch->cos_in[i] < 0.4F) continue;
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
