// SPDX-License-Identifier: Apache-2.0
#include "fitter/photometric/photometric_light.h"

#include <algorithm>
#include <cmath>

namespace stratalux::fit {

EmissionLobe LambertianLobe(const Eigen::Vector3d& axis, double exponent) {
  return [=](const Eigen::Vector3d& leaving) { return std::pow(std::max(0.0, axis.dot(leaving)), exponent); };
}

LightAtPoint PhotometricLight::At(const Eigen::Vector3d& x_in_camera_mm) const {
  LightAtPoint light;
  double scale = 1.0;
  if (const auto* near = std::get_if<NearLight>(&place)) {
    const Eigen::Vector3d to_light = near->position_mm - x_in_camera_mm;
    light.to_light = to_light / to_light.norm();
    scale = (near->lobe ? near->lobe(-light.to_light) : 1.0) / to_light.squaredNorm();
  } else {
    light.to_light = std::get<FarLight>(place).to_light;
  }
  for (size_t c = 0; c < strength.size(); ++c) light.white_dn[c] = strength[c] * scale;
  return light;
}

Status PhotometricLight::Validate() const {
  for (const double s : strength)
    if (!(s >= 0.0) || !std::isfinite(s))
      return Status::Usage("light: strength " + std::to_string(s) + ", allowed: 0 and above");
  if (const auto* near = std::get_if<NearLight>(&place)) {
    if (!near->position_mm.allFinite()) return Status::Usage("light: its position is not finite");
  } else if (const double length = std::get<FarLight>(place).to_light.norm(); !(std::abs(length - 1.0) < 1e-6)) {
    return Status::Usage("light: its direction has length " + std::to_string(length) + ", needs 1");
  }
  return Status::Ok();
}

PhotometricLight LightOfProjector(const ProjectorCalibration& projector, double exposure_ms) {
  const EmissionLobe lobe = [projector](const Eigen::Vector3d& leaving) {
    const auto pixel = projector.ProjectFromCamera(projector.CentreInCamera() + leaving);
    return pixel && projector.model.Contains(*pixel) ? projector.Falloff(*pixel) : 0.0;
  };
  PhotometricLight light{NearLight{projector.CentreInCamera(), lobe}, {}};
  for (size_t c = 0; c < light.strength.size(); ++c) light.strength[c] = projector.white_dn_mm2_per_ms[c] * exposure_ms;
  return light;
}

}  // namespace stratalux::fit
