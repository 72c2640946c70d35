// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/mixture_map.h"

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

}  // namespace stratalux::fit
