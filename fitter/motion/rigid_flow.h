// SPDX-License-Identifier: Apache-2.0
// How a head moved between two pictures under the same light (docs/math/motion.md, eq. 1 and 2).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "fitter/motion/skin_detail.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/capture/rig_calibration.h"
#include "shared/geometry/rigid3.h"

namespace stratalux::fit {

// Turn (rad), then shift (mm).
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

// A small rigid motion about a pivot: x -> pivot + R(turn) (x - pivot) + shift, camera frame.
struct SmallMotion {
  Eigen::Vector3d turn_rad = Eigen::Vector3d::Zero();
  Eigen::Vector3d shift_mm = Eigen::Vector3d::Zero();

  [[nodiscard]] Rigid3 About(const Eigen::Vector3d& pivot) const;
  [[nodiscard]] Vector6 Vector() const;
  static SmallMotion From(const Vector6& v) { return {v.head<3>(), v.tail<3>()}; }
};

struct FlowOptions {
  double fine_quads = 1.0;    // standard deviation of the Gaussian that takes noise off
  double coarse_quads = 8.0;  // of the one that is taken for what the model of the light lacks
  // Prior: in any direction a head sways by some millimetres. It decides what the pictures leave open.
  double prior_shift_mm = 2.0;
  double prior_turn_rad = 0.02;
  // What the model of the light leaves, beyond noise. Towards the camera the picture hardly changes, by a
  // five-thousandth a fifth of a millimetre: that is left to the codes.
  double model_sigma_mm = 0.01;
  double model_sigma_depth_mm = 0.5;
  double model_sigma_rad = 0.0003;
  double robust_scale = 4.685;  // Tukey's, in robust standard deviations of the residual
  int iterations = 12;
  int least_quads = 400;         // fewer say nothing
  int coarse_above_quads = 300;  // a surface wider than that is first compared binned 4 x 4
  [[nodiscard]] Status Validate() const;
};

struct RigidFlow {
  SmallMotion motion;
  Matrix6 covariance = Matrix6::Identity();
  int64_t quads = 0;  // compared
  // Of the logarithm of the light's detail, robust standard deviation: as it is left, and as it would be of a head that
  // did not move.
  double residual = 0.0, residual_still = 0.0;
  double chi_squared = 0.0;  // of the motion by the data alone: of a head at rest 6 in the mean
};

// Of a head in `from`, how it lies in each of the `later` pictures; each is begun where the one before was found. All
// show light on quads, W x H x C, above black, NaN where saturated, of a lamp at `light_mm` (camera frame); `lit`: 1
// where it shines on the surface, which is that of `from`. nullopt where too little is lit, or nothing but the prior
// says anything.
[[nodiscard]] std::vector<std::optional<RigidFlow>> FindRigidFlows(
    const Image<float>& from, std::span<const Image<float>> later, const Image<uint8_t>& lit, const SurfaceMap& surface,
    const CameraCalibration& camera, const Eigen::Vector3d& light_mm, const Eigen::Vector3d& pivot,
    const FlowOptions& options = {});

}  // namespace stratalux::fit
