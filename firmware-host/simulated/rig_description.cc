// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/rig_description.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

constexpr double kWorkingDistanceMm = 700.0;
constexpr double kFieldOfViewMm = 300.0;   // width seen at the working distance
constexpr double kWhiteTargetDn = 3500.0;  // of a white target at that distance, 16 ms, on the axis
constexpr double kNominalExposureMs = 16.0;

struct Place {
  Eigen::Vector3d centre_mm;
  double roll_deg;
  std::array<double, 3> colour;  // relative strength
};

// Spread over the angle across the lines (columns) as well as in height: four lights of four-source stereo.
const std::array<Place, 4> kPlaces = {{{{-450, -60, 0}, 1.0, {1.00, 1.00, 0.97}},
                                       {{-180, -300, 20}, -1.5, {0.98, 1.02, 1.00}},
                                       {{200, 300, 20}, 0.7, {1.03, 0.99, 0.98}},
                                       {{430, 80, 0}, -0.8, {0.99, 1.00, 1.02}}}};

// From the projector to the working point.
double LightDistance(const ProjectorCalibration& projector) {
  return (Eigen::Vector3d(0, 4, kWorkingDistanceMm) - projector.CentreInCamera()).norm();
}

constexpr int kResponseNodes = 65;

template <typename F>
std::vector<double> Curve(const F& value) {
  std::vector<double> curve;
  for (int k = 0; k < kResponseNodes; ++k) curve.push_back(value(static_cast<double>(k) / (kResponseNodes - 1)));
  return curve;
}

// Inverse of the sensor's v (1 - c v).
std::vector<double> ResponseOf(const CameraElectronics& camera) {
  const double c = camera.compression;
  if (c == 0.0) return {};
  return Curve([c](double level) { return (1.0 - std::sqrt(std::max(0.0, 1.0 - 4.0 * c * level))) / (2.0 * c); });
}

// cos^4 of the field angle to the power given, by the record's polynomial: exact at the axis, half the squared corner
// distance and the corner, to 0.0005 between.
std::array<double, 2> VignettingOf(const Pinhole& camera, double power) {
  const double corner =
      0.25 * (double(camera.width) * camera.width + double(camera.height) * camera.height) / (camera.fx * camera.fx);
  const double half = std::pow(1.0 + 0.5 * corner, -2.0 * power) - 1.0,
               full = std::pow(1.0 + corner, -2.0 * power) - 1.0;
  const double fourth = 2.0 * full - 4.0 * half;
  return {full - fourth, fourth};
}

}  // namespace

RigCalibration DescribeSimulatedRig(const SimulatedRigOptions& options) {
  RigCalibration rig;
  rig.source = "simulation (exact)";
  CameraCalibration& camera = rig.camera;
  const double f = kWorkingDistanceMm * options.camera_width / kFieldOfViewMm;
  camera.model = {options.camera_width,
                  options.camera_height,
                  f,
                  f,
                  (options.camera_width - 1) / 2.0 + 0.004 * options.camera_width,
                  (options.camera_height - 1) / 2.0 - 0.003 * options.camera_height,
                  {}};
  const CameraElectronics& electronics = options.devices.camera;
  std::copy(electronics.distortion.begin(), electronics.distortion.end(), camera.model.distortion.begin());
  camera.cfa = electronics.cfa;
  camera.black_level_dn = electronics.black_level_dn;
  camera.saturation_dn = electronics.bits == 10 ? 4092.0 : 4095.0;
  camera.gain_e_per_dn = electronics.gain_e_per_dn;
  camera.read_noise_dn = electronics.read_noise_dn;
  camera.line_blur_px = electronics.blur_px;
  camera.response = ResponseOf(electronics);
  camera.vignetting = VignettingOf(camera.model, electronics.vignetting);
  for (size_t p = 0; p < kPlaces.size(); ++p) {
    const Place& place = kPlaces[p];
    ProjectorCalibration projector;
    projector.name = "projector " + std::to_string(p);
    const double fp = 2690.0 * options.projector_width / 1024.0;
    projector.model = {options.projector_width,
                       options.projector_height,
                       fp,
                       fp,
                       (options.projector_width - 1) / 2.0 + 6.0,
                       (options.projector_height - 1) / 2.0 - 9.0,
                       {}};
    const ProjectorOptics& optics = options.devices.ForProjector(p);
    std::copy(optics.distortion.begin(), optics.distortion.end(), projector.model.distortion.begin());
    projector.camera_from_projector = LookAt(place.centre_mm, {0, 4, kWorkingDistanceMm});
    projector.camera_from_projector.rotation = projector.camera_from_projector.rotation *
                                               Eigen::AngleAxisd(RadFromDeg(place.roll_deg), Eigen::Vector3d::UnitZ());
    projector.line_blur_px = optics.BlurPx(LightDistance(projector));
    projector.black_level = optics.black_level;
    projector.falloff = optics.falloff;
    if (optics.gamma != 1.0)
      projector.response = Curve([&optics](double grey) { return std::pow(grey, optics.gamma); });
    for (int c = 0; c < 3; ++c)
      projector.white_dn_mm2_per_ms[c] =
          kWhiteTargetDn / kNominalExposureMs * kWorkingDistanceMm * kWorkingDistanceMm * place.colour[c];
    rig.projectors.push_back(projector);
  }
  return rig;
}

}  // namespace stratalux::rig
