// SPDX-License-Identifier: Apache-2.0
// What lies beyond the edge of a surface. Where the camera's view ends, at a silhouette or a hole, the skin goes on:
// light that enters there comes out on this side.
#pragma once

#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// The surface and the quads next to it, each on the tangent planes of its known neighbours (the mean in inverse depth,
// in which a plane is linear), with the normal as it turns from quad to quad. Left out are those whose plane no longer
// faces the camera, and those whose neighbours are further apart in depth than `max_edge_mm`: they stand between two
// surfaces. depth_sigma_mm of the new quads is NaN.
[[nodiscard]] SurfaceMap WithRim(const SurfaceMap& surface, double max_edge_mm);

}  // namespace stratalux::fit
