// SPDX-License-Identifier: Apache-2.0
// A light as photometric stereo asks for it: where it stands, and what white would read in it
// (docs/math/photometric.md).
#pragma once

#include <Eigen/Core>
#include <array>
#include <functional>
#include <variant>

#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

// What leaves a near light in a unit direction of the camera frame, as a share of its strength; 0 where nothing does.
// Called by several threads at once. Empty: alike in all directions.
using EmissionLobe = std::function<double(const Eigen::Vector3d& leaving)>;

// max(0, cos)^exponent about the (unit) axis: 1 is Lambert's emitter, a light-emitting diode without a lens.
[[nodiscard]] EmissionLobe LambertianLobe(const Eigen::Vector3d& axis, double exponent);

struct NearLight {
  Eigen::Vector3d position_mm = Eigen::Vector3d::Zero();  // camera frame
  EmissionLobe lobe;
};

struct FarLight {
  Eigen::Vector3d to_light = -Eigen::Vector3d::UnitZ();  // unit, camera frame
};

// A light at one point of the surface.
struct LightAtPoint {
  Eigen::Vector3d to_light;        // unit; not finite at the light itself
  std::array<double, 3> white_dn;  // of a perfect white Lambertian target that faces the light; 0 where it sends none
};

struct PhotometricLight {
  std::variant<NearLight, FarLight> place;
  // Per colour channel, of a perfect white Lambertian target that faces the light: near, digital numbers times mm^2 of
  // squared distance on the lobe's peak (white = strength * lobe / distance^2); far, digital numbers.
  std::array<double, 3> strength{};

  [[nodiscard]] LightAtPoint At(const Eigen::Vector3d& x_in_camera_mm) const;
  // kUsage: a strength that is negative or not finite, or a direction that is not of unit length.
  [[nodiscard]] Status Validate() const;
};

// The calibrated projector with all columns on: near, its fall-off as lobe, dark outside its picture. At() then gives
// ProjectorCalibration::WhiteTargetDn of a target that faces it.
[[nodiscard]] PhotometricLight LightOfProjector(const ProjectorCalibration& projector, double exposure_ms);

}  // namespace stratalux::fit
