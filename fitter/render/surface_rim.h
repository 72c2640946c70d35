// SPDX-License-Identifier: Apache-2.0
// What lies beyond the edge of a surface. Where the camera's view ends, at a silhouette or a hole, the skin goes on:
// light that enters there comes out on this side.
#pragma once

#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// The surface and the quads next to it. Each continues the two known quads in a row of every direction that has them:
// as far on the nearer one's tangent plane as that lies from the other, with the normal turned on likewise; their mean.
// At a silhouette such a point lies beside its own camera ray, where the camera no longer sees the skin. Left out are
// quads between neighbours that are not OnOneSurface. depth_sigma_mm of the new quads is NaN.
[[nodiscard]] SurfaceMap WithRim(const SurfaceMap& surface);

}  // namespace stratalux::fit
