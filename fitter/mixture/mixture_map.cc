// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/mixture_map.h"

#include <algorithm>

namespace stratalux::fit {

const char* ToString(FitReason reason) {
  constexpr const char* kNames[] = {"fitted",   "outside mask", "no projector",
                                    "too dark", "not finite",   "depth not estimable"};
  return kNames[static_cast<int>(reason)];
}

MixtureMap ProfilesOf(const MixtureMap& map, std::span<const int64_t> which) {
  MixtureMap part = map;
  const auto copy = [&](auto field, size_t each) {
    const auto& from = map.*field;
    auto& to = part.*field;
    for (size_t k = 0; k < which.size() && !from.empty(); ++k)
      if (which[k] >= 0)
        std::copy_n(from.begin() + which[k] * static_cast<int64_t>(each), each,
                    to.begin() + static_cast<int64_t>(k * each));
  };
  const auto layers = static_cast<size_t>(map.layers);
  for (const auto field : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm}) copy(field, layers);
  for (const auto field : {&MixtureMap::surface, &MixtureMap::background}) copy(field, map.training_projectors.size());
  for (const auto field : {&MixtureMap::divergence, &MixtureMap::prior_share}) copy(field, 1);
  copy(&MixtureMap::iterations, 1);
  copy(&MixtureMap::reason, 1);
  part.place.clear();
  part.place.reserve(which.size());
  for (size_t k = 0; k < which.size(); ++k) part.place.push_back(map.PlaceOf(std::max<int64_t>(which[k], 0)));
  for (size_t k = 0; k < which.size(); ++k)
    if (which[k] < 0) part.reason[k] = static_cast<uint8_t>(FitReason::kOutsideMask);
  return part;
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
