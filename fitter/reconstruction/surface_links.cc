// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/surface_links.h"

#include "fitter/reconstruction/one_surface.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {

SurfaceLinks::SurfaceLinks(const SurfaceMap& surface) : links_(surface.width(), surface.height()) {
  const auto links_of = [&](int i, int j) {
    uint8_t links = 0;
    for (size_t k = 0; k < kNeighbours.size() && surface.mask(i, j) != 0; ++k) {
      const int x = i + kNeighbours[k][0], y = j + kNeighbours[k][1];
      if (surface.mask.contains(x, y) && surface.mask(x, y) != 0 && OnOneSurface(surface, i, j, x, y))
        links |= static_cast<uint8_t>(1U << k);
    }
    return links;
  };
  ParallelFor(surface.height(), 4, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) links_(i, j) = links_of(i, j);
  });
}

}  // namespace stratalux::fit
