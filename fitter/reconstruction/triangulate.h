// SPDX-License-Identifier: Apache-2.0
// Depth of every quad from all projectors together: one unknown a camera ray (model section 3, docs/math/geometry.md).
#pragma once

#include <cstdint>
#include <span>

#include "fitter/reconstruction/surface_map.h"
#include "fitter/structured_light/decoded_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

struct TriangulateOptions {
  // Added in quadrature to the decoded sigma: what calibration and the displacement by scattering leave (columns).
  double model_sigma_px = 0.2;
  double robust_scale = 3.0;   // Geman-McClure scale, in sigmas
  double reject_sigmas = 5.0;  // a residual beyond counts as an outlier and does not enter the covariance
  int iterations = 8;
  double min_depth_mm = 50.0;
  double max_depth_mm = 10000.0;
  double max_depth_sigma_mm = 2.0;  // less certain sites are dropped
  int min_sites = 2;                // of a quad's four (mono: 1 site a quad)
  double max_step_mm = 4.0;         // neighbours further apart in depth are not connected
  int min_component = 60;           // quads; smaller islands are dropped
  [[nodiscard]] Status Validate() const;
};

struct TriangulationCounts {
  int64_t sites = 0;           // triangulated
  int64_t undecoded = 0;       // sites that no projector reached with a valid code
  int64_t inconsistent = 0;    // sites whose projectors do not agree, or too uncertain, or out of range
  int64_t rejected_views = 0;  // (site, projector) pairs found to be outliers
  int64_t islands = 0;         // quads dropped with small components
};

struct Triangulation {
  // On quads. `normal` is NaN: SmoothSurface gives it. `depth_sigma_mm` holds the noise of decoding and the model
  // sigma, along the camera ray.
  SurfaceMap surface;
  // By projector, on quads: what its codes weigh in the depth, over codes without noise at all sites of the quad; by
  // their sigmas and the last round's robust weights.
  std::vector<Image<float>> weights;
  TriangulationCounts counts;
};

// `decoded[p]`: maps of projector p at the size of the camera's frames. For each site the ray length t minimises
//   sum_p rho((C_p - C(t x))^2 / sigma^2) + rho((R_p - R(t x))^2 / sigma^2),   rho of Geman-McClure,
// by Gauss-Newton from the best of the projectors' own linear solutions. An axis that was not captured (NaN) is left
// out. A quad holds the weighted mean depth of its sites on the ray through its centre. kUsage: sizes or numbers of
// projectors differ. Reentrant, thread-count independent.
[[nodiscard]] Result<Triangulation> Triangulate(std::span<const DecodedMap> decoded, const RigCalibration& rig,
                                                const TriangulateOptions& options = {});

}  // namespace stratalux::fit
