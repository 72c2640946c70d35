// SPDX-License-Identifier: Apache-2.0
// Projector coordinates at sub-pixel camera points, such as board corners: a robust homography over the decoded sites
// around the point [Moreno & Taubin 2012, section 3.2].
#pragma once

#include <Eigen/Core>
#include <optional>

#include "fitter/structured_light/decoded_map.h"

namespace stratalux::fit {

struct LocalHomographyOptions {
  int radius_px = 16;        // the window has 2 radius + 1 sites a side
  double inlier_px = 1.0;    // projector px: decoded columns carry half a pixel of quantisation
  int trials = 60;           // 4-point samples; enough for 50 % outliers with probability 0.98
  double min_inliers = 0.4;  // of the valid sites
  int min_sites = 40;        // valid sites in the window
};

struct ProjectorPoint {
  Eigen::Vector2d column_row;  // projector px
  int inliers = 0;
  double rms_px = 0.0;  // of the inliers about the homography, weighted by the sites' variances
};

// nullopt where too few sites are valid or agree. Deterministic: the samples depend on the window alone. Reentrant.
[[nodiscard]] std::optional<ProjectorPoint> LookUpProjectorPoint(const DecodedMap& map,
                                                                 const Eigen::Vector2d& camera_px,
                                                                 const LocalHomographyOptions& options = {});

}  // namespace stratalux::fit
