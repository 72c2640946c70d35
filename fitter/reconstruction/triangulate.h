// SPDX-License-Identifier: Apache-2.0
// Depth of every quad from all projectors together: one unknown a camera ray (model section 3, docs/math/geometry.md).
#pragma once

#include <cstdint>
#include <span>
#include <string>

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
  // Of the range: less certain sites are dropped. Beyond, a range is no longer normal where its codes are (the second
  // order is sigma / range of the first), and what parallel rays say lies anywhere.
  double max_relative_sigma = 0.03;
  int min_sites = 2;       // of a quad's four (mono: 1 site a quad)
  int min_component = 60;  // quads; smaller islands are dropped
  [[nodiscard]] Status Validate() const;
};

struct TriangulationCounts {
  int64_t sites = 0;           // triangulated
  int64_t undecoded = 0;       // sites that no projector reached with a valid code
  int64_t inconsistent = 0;    // sites whose projectors do not agree, or whose rays do not meet before the camera
  int64_t uncertain = 0;       // sites beyond max_relative_sigma
  int64_t rejected_views = 0;  // (site, projector) pairs found to be outliers
  int64_t lone = 0;            // quads dropped for fewer sites than min_sites
  int64_t mixed = 0;           // quads dropped whose sites lie on two surfaces
  int64_t islands = 0;         // quads dropped with small components
};
// For an error where nothing is left: which gate took how much of it, the largest first. `unsmoothed`: quads that
// SmoothSurface dropped.
[[nodiscard]] std::string WhyNoSurface(const TriangulationCounts& counts, int64_t unsmoothed = 0);

struct Triangulation {
  // On quads, each point where its sites are: not quite in the middle of a quad that has lost some. `normal` is NaN;
  // SmoothSurface gives it, and points on the rays through the quads' centres. `depth_sigma_mm` holds the noise of
  // decoding and the model sigma, along the camera ray.
  SurfaceMap surface;
  // On quads: of depth_sigma_mm, what decoding left, independent from quad to quad. The model's part is common to
  // neighbours, and no smoothing lowers it.
  Image<float> noise_sigma_mm;
  // By projector, on quads: what its codes weigh in the depth, over codes without noise at all sites of the quad; by
  // their sigmas and the last round's robust weights.
  std::vector<Image<float>> weights;
  // On quads: how far the projectors' own depths scatter about the joint one, weighted as they are in it, root mean
  // square; NaN where one projector alone tells. What noise, calibration and light that scattered leave between them.
  Image<float> disagreement_mm;
  TriangulationCounts counts;
};

// `decoded[p]`: maps of projector p at the size of the camera's frames. For each site the ray length t minimises
//   sum_p rho((C_p - C(t x))^2 / sigma^2) + rho((R_p - R(t x))^2 / sigma^2),   rho of Geman-McClure,
// by Gauss-Newton from the best of the projectors' own linear solutions. An axis that was not captured (NaN) is left
// out. A quad holds the weighted mean of its sites, in the image and of inverse depth. kUsage: sizes or numbers of
// projectors differ. Reentrant, thread-count independent.
[[nodiscard]] Result<Triangulation> Triangulate(std::span<const DecodedMap> decoded, const RigCalibration& rig,
                                                const TriangulateOptions& options = {});

}  // namespace stratalux::fit
