// SPDX-License-Identifier: Apache-2.0
// Removal of small disconnected pieces of a surface: wrong codes and speckle come in islands.
#pragma once

#include <cstdint>

#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// Marks a quad as unknown: NaN maps, mask 0.
void ForgetQuad(SurfaceMap& surface, int i, int j);

// Quads are connected to their four neighbours where the depths (z) differ by at most `max_step_mm`. Components of
// fewer than `min_quads` are forgotten; returns the number of quads dropped.
int64_t RemoveIslands(SurfaceMap& surface, double max_step_mm, int min_quads);

}  // namespace stratalux::fit
