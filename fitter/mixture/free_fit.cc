// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/free_fit.h"

#include <algorithm>
#include <cmath>

#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// Sums over the lights so far, in the fields of the map that they end in: w, w s mu, w sigma^2; `leverage`: w s^2.
void AddLight(const MixtureMap& free, const SrdBatch& batch, size_t light, size_t lights, MixtureMap& sum,
              std::vector<float>& leverage, std::vector<uint8_t>& count) {
  ParallelFor(sum.profiles(), 1024, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (!free.Fitted(i)) {
        // The reason of a light that failed, unless another was fitted or found worse.
        if (!sum.Fitted(i)) sum.reason[i] = std::max(sum.reason[i], free.reason[i]);
        continue;
      }
      sum.reason[i] = static_cast<uint8_t>(FitReason::kFitted);
      ++count[i];
      const double s = ShiftCoefficient(sum.scattering, batch, i);
      for (int64_t at = i * sum.layers; at < (i + 1) * sum.layers; ++at) {
        const double w = free.weight[at];
        sum.weight[at] += static_cast<float>(w);
        sum.depth_mm[at] += static_cast<float>(w * s * free.depth_mm[at]);
        sum.sigma_mm[at] += static_cast<float>(w * free.sigma_mm[at] * free.sigma_mm[at]);
        leverage[at] += static_cast<float>(w * s * s);
      }
      sum.surface[i * lights + light] = free.surface[i];
      sum.background[i * lights + light] = free.background[i];
      sum.divergence[i] += free.divergence[i];
      if (!sum.prior_share.empty()) sum.prior_share[i] += free.prior_share[i];
      sum.iterations[i] = static_cast<uint16_t>(std::min(65535, sum.iterations[i] + free.iterations[i]));
    }
  });
}

void Average(const EmOptions& options, const std::vector<float>& leverage, const std::vector<uint8_t>& count,
             MixtureMap& map) {
  ParallelFor(map.profiles(), 1024, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (count[i] == 0) continue;
      double weights = 0.0, leverages = 0.0;
      for (int64_t at = i * map.layers; at < (i + 1) * map.layers; ++at) {
        const double w = map.weight[at];
        weights += w;
        leverages += leverage[at];
        const double depth = leverage[at] > 1e-4 * w ? map.depth_mm[at] / leverage[at] : 0.0;
        map.depth_mm[at] = static_cast<float>(std::clamp(depth, options.min_depth_mm, options.max_depth_mm));
        map.sigma_mm[at] = w > 0.0 ? static_cast<float>(std::sqrt(map.sigma_mm[at] / w)) : 1.0F;
        map.weight[at] = static_cast<float>(w / count[i]);
      }
      map.divergence[i] /= static_cast<float>(count[i]);
      if (!map.prior_share.empty()) map.prior_share[i] /= static_cast<float>(count[i]);
      map.iterations[i] = static_cast<uint16_t>(map.iterations[i] / count[i]);
      // |s| below 0.02, as for the tied fit: shifts tell nothing of depths.
      if (leverages < 4e-4 * weights) map.reason[i] = static_cast<uint8_t>(FitReason::kDepthNotEstimable);
    }
  });
}

}  // namespace

Result<MixtureMap> FitFree(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int width,
                           int height, int channels, EmOptions options, std::span<const LayerSet> start,
                           const std::function<void(int64_t)>& progress) {
  if (lights.empty()) return Status::Usage("EM needs at least one light");
  options.scattering.mode = FitMode::kFree;
  std::vector<LayerSet> centred(start.begin(), start.end());
  for (LayerSet& layers : centred) std::fill(layers.depth_mm.begin(), layers.depth_mm.end(), 0.0);
  MixtureMap map;
  std::vector<float> leverage;
  std::vector<uint8_t> count(static_cast<size_t>(width) * height * channels, 0);
  for (size_t p = 0; p < lights.size(); ++p) {
    SLX_ASSIGN_OR_RETURN(MixtureMap free, FitMixture({&lights[p], 1}, {projectors[p]}, width, height, channels, options,
                                                     centred, progress));
    if (p == 0) {
      map = free;
      map.scattering.mode = FitMode::kTied;
      map.training_projectors = projectors;
      for (auto* v : {&map.weight, &map.depth_mm, &map.sigma_mm, &map.divergence, &map.prior_share})
        std::fill(v->begin(), v->end(), 0.0F);
      std::fill(map.iterations.begin(), map.iterations.end(), uint16_t{0});
      std::fill(map.reason.begin(), map.reason.end(), static_cast<uint8_t>(FitReason::kNoProjector));
      for (auto* v : {&map.surface, &map.background}) v->assign(count.size() * lights.size(), 0.0F);
      leverage.assign(map.weight.size(), 0.0F);
    }
    AddLight(free, *lights[p], p, lights.size(), map, leverage, count);
  }
  Average(options, leverage, count, map);
  for (int64_t i = 0; i < map.profiles(); ++i)
    if (count[i] == 0) std::fill_n(map.sigma_mm.begin() + i * map.layers, map.layers, 1.0F);
  return map;
}

}  // namespace stratalux::fit
