// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/components.h"

#include <array>
#include <utility>
#include <vector>

#include "fitter/reconstruction/one_surface.h"

namespace stratalux::fit {
namespace {

// The component of the seed, by flood fill; `seen` marks what was visited.
std::vector<std::pair<int, int>> Component(const SurfaceMap& surface, std::pair<int, int> seed, Image<uint8_t>& seen) {
  std::vector<std::pair<int, int>> members = {seed};
  seen(seed.first, seed.second) = 1;
  for (size_t k = 0; k < members.size(); ++k) {
    const auto [x, y] = members[k];
    const std::array<std::pair<int, int>, 4> neighbours = {std::pair{x - 1, y}, std::pair{x + 1, y},
                                                           std::pair{x, y - 1}, std::pair{x, y + 1}};
    for (const auto& [i, j] : neighbours) {
      if (!seen.contains(i, j) || seen(i, j) != 0 || surface.mask(i, j) == 0) continue;
      if (!OnOneSurface(surface, x, y, i, j)) continue;
      seen(i, j) = 1;
      members.emplace_back(i, j);
    }
  }
  return members;
}

}  // namespace

void ForgetQuad(SurfaceMap& surface, int i, int j) {
  const float nan = std::nanf("");
  for (int k = 0; k < 3; ++k) surface.point_mm(i, j, k) = surface.normal(i, j, k) = nan;
  surface.depth_sigma_mm(i, j) = nan;
  surface.mask(i, j) = 0;
}

int64_t RemoveIslands(SurfaceMap& surface, int min_quads) {
  Image<uint8_t> seen(surface.width(), surface.height());
  int64_t dropped = 0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0 || seen(i, j) != 0) continue;
      const auto members = Component(surface, {i, j}, seen);
      if (static_cast<int>(members.size()) >= min_quads) continue;
      for (const auto& [x, y] : members) ForgetQuad(surface, x, y);
      dropped += static_cast<int64_t>(members.size());
    }
  return dropped;
}

}  // namespace stratalux::fit
