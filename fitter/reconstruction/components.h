// SPDX-License-Identifier: Apache-2.0
// Removal of small disconnected pieces of a surface: wrong codes and speckle come in islands.
#pragma once

#include <cstdint>

#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// Marks a quad as unknown: NaN maps, mask 0.
void ForgetQuad(SurfaceMap& surface, int i, int j);

// Quads are connected to those of their four neighbours that are OnOneSurface with them. Components of fewer than
// `min_quads` are forgotten; returns the number of quads dropped.
int64_t RemoveIslands(SurfaceMap& surface, int min_quads);

}  // namespace stratalux::fit
