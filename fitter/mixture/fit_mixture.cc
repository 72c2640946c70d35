// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/fit_mixture.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "fitter/mixture/em_block.h"
#include "fitter/mixture/shift_law.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// A profile is usable when its samples are finite, not constant, and add up to light.
FitReason Judge(const SrdBatch& batch, int64_t profile) {
  if (batch.valid[profile] == 0) return FitReason::kNoProjector;
  const float* y = batch.y.data() + profile * batch.samples;
  const float* v = batch.variance.data() + profile * batch.samples;
  double sum = 0.0;
  float low = y[0], high = y[0];
  for (int k = 0; k < batch.samples; ++k) {
    if (!std::isfinite(y[k]) || !std::isfinite(v[k]) || !(v[k] >= 0.0F)) return FitReason::kNotFinite;
    sum += y[k];
    low = std::min(low, y[k]);
    high = std::max(high, y[k]);
  }
  const bool finite = std::isfinite(batch.first_u_mm[profile]) && std::isfinite(batch.step_mm[profile]) &&
                      batch.step_mm[profile] > 0.0F && std::isfinite(batch.blur_mm[profile]) &&
                      std::isfinite(batch.slope_in[profile]) && std::isfinite(batch.slope_out[profile]);
  if (!finite) return FitReason::kNotFinite;
  return sum > 0.0 && high > low ? FitReason::kFitted : FitReason::kTooDark;
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
  map.shift_law = options.shift_law;
  map.eta = options.eta;
  map.tau = options.tau;
  map.gain_model = options.gain_model;
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

}  // namespace

Status EmOptions::Validate() const {
  if (layers < 1 || layers > 32) return Status::Usage("layers = " + std::to_string(layers) + ", allowed: 1 .. 32");
  if (!(eta >= 1.0 && eta <= 3.0)) return Status::Usage("eta = " + std::to_string(eta) + ", allowed: 1 .. 3");
  if (max_iterations < 1 || max_iterations > 100000)
    return Status::Usage("max_iterations = " + std::to_string(max_iterations) + ", allowed: 1 .. 100000");
  if (!(tolerance >= 0.0)) return Status::Usage("tolerance must not be negative");
  if (cells_per_sample < 1 || cells_per_sample > 64) return Status::Usage("cells_per_sample must lie in 1 .. 64");
  return Status::Ok();
}

Result<MixtureMap> FitMixture(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int width,
                              int height, int channels, const EmOptions& options,
                              const std::function<void(int64_t)>& progress) {
  SLX_RETURN_IF_ERROR(options.Validate());
  const int64_t profiles = int64_t{width} * height * channels;
  SLX_RETURN_IF_ERROR(CheckBatches(lights, profiles));
  MixtureMap map = EmptyMap(width, height, channels, options, projectors);

  // Judge every light of every profile once; unusable ones are masked in copies of the flags alone.
  std::vector<std::vector<uint8_t>> usable(lights.size(), std::vector<uint8_t>(profiles, 0));
  std::vector<int64_t> work;
  for (int64_t i = 0; i < profiles; ++i) {
    FitReason worst = FitReason::kNoProjector;
    bool any = false;
    for (size_t p = 0; p < lights.size(); ++p) {
      const FitReason reason = Judge(*lights[p], i);
      usable[p][i] = reason == FitReason::kFitted ? 1 : 0;
      any = any || usable[p][i] != 0;
      if (reason != FitReason::kNoProjector && reason != FitReason::kFitted) worst = reason;
    }
    map.reason[i] = static_cast<uint8_t>(any ? FitReason::kFitted : worst);
    if (any) work.push_back(i);
  }

  // Blocks of sixteen usable profiles of one channel each, gathered so that no lane runs empty.
  std::stable_sort(work.begin(), work.end(), [&](int64_t a, int64_t b) { return a % channels < b % channels; });
  const int64_t blocks = (static_cast<int64_t>(work.size()) + kLanes - 1) / kLanes;
  ParallelFor(blocks, 8, [&](int64_t begin, int64_t end) {
    for (int64_t block = begin; block < end; ++block) {
      const int count = static_cast<int>(std::min<int64_t>(kLanes, static_cast<int64_t>(work.size()) - block * kLanes));
      const std::span<const int64_t> members(work.data() + block * kLanes, count);
      EmBlock em(lights, usable, members, options);
      const int iterations = em.Run();
      const auto divergence = em.Divergence();
      for (int lane = 0; lane < count; ++lane) {
        const int64_t i = members[lane];
        for (int l = 0; l < options.layers; ++l) {
          map.weight[i * options.layers + l] = em.Weight(l, lane);
          map.depth_mm[i * options.layers + l] = em.DepthMm(l, lane);
          map.sigma_mm[i * options.layers + l] = em.SigmaMm(l, lane);
        }
        for (size_t p = 0; p < lights.size(); ++p) {
          map.surface[i * lights.size() + p] = em.Light(static_cast<int>(p)).surface[lane];
          map.background[i * lights.size() + p] = em.Light(static_cast<int>(p)).background[lane];
        }
        map.divergence[i] = static_cast<float>(divergence[lane]);
        map.iterations[i] = static_cast<uint16_t>(std::min(iterations, 65535));
        if (options.mode == FitMode::kTied && em.LargestShift(lane) < 0.02F)
          map.reason[i] = static_cast<uint8_t>(FitReason::kDepthNotEstimable);
      }
      if (progress) progress(count);
    }
  });
  return map;
}

LayerSet LayersOf(const MixtureMap& map, int64_t profile) {
  LayerSet set;
  for (int l = 0; l < map.layers; ++l) {
    set.weight.push_back(map.weight[profile * map.layers + l]);
    set.depth_mm.push_back(map.depth_mm[profile * map.layers + l]);
    set.sigma_mm.push_back(map.sigma_mm[profile * map.layers + l]);
  }
  return set;
}

double EstimateTau(std::span<const SrdBatch* const> lights, double eta) {
  // Centre each profile's values over its lights, then one regression through the origin.
  double xy = 0.0, xx = 0.0;
  const int64_t profiles = lights.empty() ? 0 : lights[0]->profiles();
  for (int64_t i = 0; i < profiles; ++i) {
    std::vector<double> x, y;
    for (const SrdBatch* batch : lights) {
      if (Judge(*batch, i) != FitReason::kFitted || batch->cos_in[i] < 0.4F) continue;
      double sum = 0.0;
      for (int k = 0; k < batch->samples; ++k) sum += batch->y[i * batch->samples + k];
      if (!(sum > 0.0)) continue;
      const double cos_in = batch->cos_in[i];
      x.push_back(-std::log(AngularGain(cos_in, eta, 1.0) / AngularGain(cos_in, eta, 0.0)));
      y.push_back(std::log(sum / AngularGain(cos_in, eta, 0.0)));
    }
    if (x.size() < 2) continue;
    double mx = 0.0, my = 0.0;
    for (size_t k = 0; k < x.size(); ++k) {
      mx += x[k] / static_cast<double>(x.size());
      my += y[k] / static_cast<double>(x.size());
    }
    for (size_t k = 0; k < x.size(); ++k) {
      // Highlights and shadows are outliers: bounded influence.
      const double dy = std::clamp(y[k] - my, -0.3, 0.3);
      xy += (x[k] - mx) * dy;
      xx += (x[k] - mx) * (x[k] - mx);
    }
  }
  return xx > 1e-6 ? std::clamp(-xy / xx, 0.0, 3.0) : 0.0;
}

}  // namespace stratalux::fit
