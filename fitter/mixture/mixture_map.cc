// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/mixture_map.h"

#include <algorithm>

namespace stratalux::fit {

const char* ToString(FitReason reason) {
  constexpr const char* kNames[] = {"fitted",   "outside mask", "no projector",
                                    "too dark", "not finite",   "depth not estimable"};
  return kNames[static_cast<int>(reason)];
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

UnlayeredLight MeanOfLights(const MixtureMap& map, int64_t profile) {
  const size_t lights = map.training_projectors.size();
  double surface = 0.0, background = 0.0, lit = 0.0;
  for (size_t at = profile * lights; at < (profile + 1) * lights; ++at) {
    if (!(map.surface[at] > 0.0F) && !(map.background[at] > 0.0F)) continue;
    surface += map.surface[at];
    background += map.background[at];
    lit += 1.0;
  }
  return {static_cast<float>(surface / std::max(lit, 1.0)), static_cast<float>(background / std::max(lit, 1.0))};
}

}  // namespace stratalux::fit
