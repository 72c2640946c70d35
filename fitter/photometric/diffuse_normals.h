// SPDX-License-Identifier: Apache-2.0
// Normals that light which scattered follows: those of the surface itself, filtered by how far light spreads
// (docs/math/photometric.md, "Two normals"; after Ma et al. 2007, who measured them by polarised light).
#pragma once

#include <functional>
#include <span>

#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

// For each radius in mm the share, 0 .. 1, of the light that leaves quad (i, j) in a colour which came in within so
// much of it, but for a Gaussian blur of `blurred_mm` that what it is to blur has had. False: nothing is known to
// scatter.
using EnclosedLight = std::function<bool(int i, int j, int colour, double blurred_mm, std::span<const double> radii_mm,
                                         std::span<double> shares)>;

// Of each quad x of the surface and each colour c, to unit length,
//   n_c(x) ~ sum_y A(y) rho_c(|t|) n(y),   t = y - x laid across n(x)
// over quads y that do not face away from x, A(y) their areas and rho the density of `light` around x, less the blur of
// the surface's own normals, averaged over rings as wide as x itself; as far as 99 % of it (most of the rest hardly has
// a direction), 32 sides of a quad at most. What lies further along n(x) than that is another part of the face.
// `normal`: W x H x 3, unit, of the surface itself; where nothing scatters it stays. W x H x 3C, x y z of each colour
// in turn; NaN where the surface or `normal` is not known. kUsage: sizes differ. Same input, same bits, whatever the
// number of threads; `light` is called by several.
[[nodiscard]] Result<Image<float>> DiffuseNormals(const SurfaceMap& surface, const Image<float>& normal, int colours,
                                                  const EnclosedLight& light, const CameraCalibration& camera);

// x, y, z of one colour of that.
[[nodiscard]] Image<float> NormalsOfColour(const Image<float>& diffuse, int colour);

}  // namespace stratalux::fit
