// SPDX-License-Identifier: Apache-2.0
// Fall-off of every projector, vignetting of the camera, white scale and black levels, from pictures of a matt target
// whose pose is known (docs/math/calibration.md, eq. 4 and 5).
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

// Mean over some sites of one colour, linear.
struct FlatSample {
  int projector = 0, channel = 0, pose = 0;
  Eigen::Vector2d camera_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d column_row = Eigen::Vector2d::Zero();  // of the projector, where the target is met
  // What a white target would have with unit scale, no fall-off, no vignetting: exposure cos(theta) / distance^2.
  double geometry = 0.0;
  double white_dn = 0.0;  // white less all that is not the projector's
  double sigma_dn = 0.0;
};

enum class VignettingFit { kFree, kKnown };

struct LightField {
  std::array<double, 2> vignetting{};
  double vignetting_sd = 0.0;  // of the sensitivity at r = 1
  struct OfProjector {
    std::array<double, 2> falloff{};
    double falloff_sd = 0.0;  // of the light at r = 1
    std::array<double, 3> white_dn_mm2_per_ms{};
  };
  std::vector<OfProjector> projectors;
  std::vector<double> residual;  // relative, rms, by pose
};

// Least squares (Huber) of the relative deviations from
//   white = scale_{p,c} geometry albedo F_p(column, row) V(x, y)                                                (4)
// over all poses, projectors and colours. F and V are one another's picture where a target always lies at one depth:
// kFailed then, saying so; with kKnown V is the record's. Channels without a sample get the mean of the others.
[[nodiscard]] Result<LightField> FitLightField(const std::vector<FlatSample>& samples, const RigCalibration& rig,
                                               double albedo, VignettingFit vignetting);

// Levels of one place with each projector black in turn (the others dark) and with all black at once; contrast: white
// less black.
struct BlackSample {
  double all_black_dn = 0.0;
  Eigen::VectorXd black_dn, contrast_dn;  // by projector
};

// Black over white. Where all are black, ambient light A is in once: all = A + sum_p k_p, black_q = A + k_q, and
//   all - black_q = sum_{p != q} beta_p contrast_p,   black level b = beta / (1 + beta)                         (5)
// without any assumption on A. kFailed with a single projector, which no subtraction tells from ambient light.
[[nodiscard]] Result<std::vector<double>> FitBlackLevels(const std::vector<BlackSample>& samples);

}  // namespace stratalux::fit
