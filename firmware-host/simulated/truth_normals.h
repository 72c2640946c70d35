// SPDX-License-Identifier: Apache-2.0
// Normals that light which scattered follows, by what the simulated skin does: the surface's own, averaged by where
// the light that leaves a point came in.
#pragma once

#include "firmware-host/simulated/scene/material.h"
#include "firmware-host/simulated/skin/skin_table.h"
#include "shared/geometry/pinhole.h"
#include "shared/image/image.h"
#include "shared/image/pixel_format.h"

namespace stratalux::rig {

// What the camera sees at the centres of quads.
struct SeenSurface {
  Image<float> point_mm, normal;  // W x H x 3; NaN where nothing is
  Image<Material> material;
};

// Of each quad x that light enters and each colour c, to unit length,
//   n_c(x) ~ sum_y A(y) S_c(|y - x|) n(y)
// over quads y that light enters and that do not face away, A their areas, S_c the table's light along the normal both
// ways, averaged over rings as wide as a quad; within 12 mm. Elsewhere the surface's own normal. W x H x 3C, x y z of
// each colour in turn; NaN where nothing is.
[[nodiscard]] Image<float> DiffuseNormals(const SeenSurface& seen, const SkinTable& table, const Pinhole& camera,
                                          Cfa cfa);

}  // namespace stratalux::rig
