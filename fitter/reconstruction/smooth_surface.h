// SPDX-License-Identifier: Apache-2.0
// Smoothing of the joint surface and its normals (model section 3: the SRD takes its columns from this surface).
#pragma once

#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

// Windows are of quads: of the surface's own sampling, whatever the camera and the distance.
struct SmoothOptions {
  double min_radius_quads = 2.0;  // of the smallest window; each next one is sqrt(2) times as wide
  double max_radius_quads = 16.0;
  // A wider window is taken while its depth and slopes agree with those of all narrower ones: the intervals of this
  // many standard deviations about them have a point in common.
  double agreement_sigmas = 2.0;
  double robust_scale = 3.0;  // Geman-McClure scale of the fit's residuals, in sigmas
  int min_samples = 8;        // quads in the smallest window; fewer: the quad is dropped
  [[nodiscard]] Status Validate() const;
};

// Around every known quad the inverse depth q = 1/z is fitted by a quadratic of the normalised image coordinates
// (x, y), weighted by 1/sigma^2, distance and robustness. A plane is exactly linear in q, so planes are left as they
// are at any slant; the normal follows from the gradient: n ~ -(q_x, q_y, q - x q_x - y q_y)
// (docs/math/geometry.md, eq. 11), which is the difference of the fitted q of the quads on both sides where they are on
// one surface, and else the fit's (SurfaceMap::smoothing_quads: by how much it is blurred, eq. 12). A window's
// quads are those that the centre reaches in a straight line over quads that are OnOneSurface with the one before. Its
// width follows the skin: the intersection of confidence intervals (Goldenshluger & Nemirovski 1997, Katkovnik 1999)
// stops where a quadratic bends otherwise than the surface does. `noise_sigma_mm`: of the rough depths, what is
// independent from quad to quad (Triangulation::noise_sigma_mm); the sandwich covariance of the fit lowers that part of
// depth_sigma_mm and leaves the other. `dropped`, if given: how many quads had no window. Reentrant, thread-count
// independent.
[[nodiscard]] Result<SurfaceMap> SmoothSurface(const SurfaceMap& rough, ImageView<const float> noise_sigma_mm,
                                               const RigCalibration& rig, const SmoothOptions& options = {},
                                               int64_t* dropped = nullptr);

}  // namespace stratalux::fit
