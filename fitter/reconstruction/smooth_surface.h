// SPDX-License-Identifier: Apache-2.0
// Smoothing of the joint surface and its normals (model section 3: the SRD takes its columns from this surface).
#pragma once

#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

struct SmoothOptions {
  double radius_mm = 3.5;  // of the window; the Gaussian weight has half of it as standard deviation
  // Neighbours beyond depth step = max_slope * distance + 4 sigma belong to another surface (3 = 72 degrees).
  double max_slope = 3.0;
  double robust_floor_mm = 0.15;  // Geman-McClure scale of the fit's residuals: max(this, 3 sigma)
  int iterations = 3;
  int min_samples = 10;  // quads in the window; fewer: the quad is dropped
  [[nodiscard]] Status Validate() const;
};

// Around every known quad the inverse depth q = 1/z is fitted by a quadratic of the normalised image coordinates
// (x, y), weighted by 1/sigma^2, distance and robustness. A plane is exactly linear in q, so planes are left as they
// are at any slant; the normal follows from the gradient: n ~ -(q_x, q_y, q - x q_x - y q_y)
// (docs/math/geometry.md, eq. 12). depth_sigma_mm becomes the sandwich covariance of the fit for independent samples.
// Reentrant, thread-count independent.
[[nodiscard]] Result<SurfaceMap> SmoothSurface(const SurfaceMap& rough, const RigCalibration& rig,
                                               const SmoothOptions& options = {});

}  // namespace stratalux::fit
