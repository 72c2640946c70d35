// SPDX-License-Identifier: Apache-2.0
// Which neighbours of each quad are on one surface with it, asked once for each pair.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// Reentrant once made; thread-count independent.
class SurfaceLinks {
 public:
  explicit SurfaceLinks(const SurfaceMap& surface);

  // OnOneSurface of two known quads, (x, y) one of the eight neighbours of (i, j); false where one is not known.
  [[nodiscard]] bool Linked(int i, int j, int x, int y) const {
    if (y < j || (y == j && x < i)) return Linked(x, y, i, j);
    for (size_t k = 0; k < kNeighbours.size(); ++k)
      if (x - i == kNeighbours[k][0] && y - j == kNeighbours[k][1]) return (links_(i, j) >> k & 1U) != 0;
    return false;
  }

 private:
  // Half of the eight: OnOneSurface asks the same of a pair either way round.
  static constexpr std::array<std::array<int, 2>, 4> kNeighbours = {{{1, 0}, {-1, 1}, {0, 1}, {1, 1}}};

  Image<uint8_t> links_;  // a bit for each of kNeighbours
};

}  // namespace stratalux::fit
