// SPDX-License-Identifier: Apache-2.0
// Normals with the detail of photometric stereo on the low frequencies of the triangulated surface
// (after Nehab et al. 2005, section 4.1; docs/math/photometric.md).
#pragma once

#include "fitter/photometric/photometric_stereo.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct FuseOptions {
  double window_quads = 8.0;  // standard deviation of the Gaussian within which detail and noise are compared
  [[nodiscard]] Status Validate() const;
};

// With D = photometric - geometric normal and L the Gaussian by which the surface blurs its normals (the median of
// SurfaceMap::smoothing_quads), over the quads whose normal is from light alone,
//   normal = geometric + gain (D - L D),   gain = max(0, 1 - G h sigma^2 / G |D - L D|^2)
// to unit length: what the surface resolves is the surface's; finer detail is added as far as it exceeds the
// photometric noise (Wiener's gain), G a Gaussian of window_quads, h the share of white noise that 1 - L lets pass.
// sigma^2 is the a priori variance of normal_sigma_rad, without its widening, times the scatter of the neighbourhood, G
// chi^2 / G degrees of freedom (1 where nothing is left over): narrowed as well as widened, since a model's error that
// all lights share is not in the detail. Elsewhere the geometric normal is kept, and everywhere where the surface says
// of no blur. W x H x 3, NaN outside the surface. kUsage: sizes differ.
[[nodiscard]] Result<Image<float>> FuseNormals(const SurfaceMap& surface, const PhotometricMap& photometric,
                                               const FuseOptions& options = {});

}  // namespace stratalux::fit
