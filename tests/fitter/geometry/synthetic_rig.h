// SPDX-License-Identifier: Apache-2.0
// A small opaque world for the geometry tests: four projectors, a mono camera, a sphere or plane seen through the
// Pinhole models, patterns from Pattern::Intensity through a Gaussian blur, ambient light and sensor noise.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "fitter/reconstruction/surface_map.h"
#include "fitter/separation/separate.h"
#include "fitter/structured_light/gray_decoder.h"
#include "shared/capture/rig_calibration.h"
#include "shared/pattern/pattern.h"

namespace stratalux::fit {

[[nodiscard]] RigCalibration SyntheticRig();

// Range along a unit camera ray to the surface, and its normal there.
struct Hit {
  Eigen::Vector3d point;
  Eigen::Vector3d normal;
};
using Surface = std::function<std::optional<Hit>(const Eigen::Vector3d& ray)>;
[[nodiscard]] Surface Sphere(const Eigen::Vector3d& centre, double radius_mm);
[[nodiscard]] Surface Plane(const Eigen::Vector3d& point, const Eigen::Vector3d& normal);
// As a head before the rig.
inline const Surface kBall = Sphere({0, 0, 680}, 80.0);

struct Shot {
  double albedo = 0.6;
  double global = 0.0;       // L_g over L_d: light that every pattern spreads evenly
  double ambient_dn = 20.0;  // above the black level
  double blur_px = 0.7;      // of the projected pattern, projector px
  double white_dn = 1500.0;  // of a white target facing the light
  bool noise = false;
  uint64_t seed = 1;
  ColumnCode code = ColumnCode::kGray;
};

// One projector's frames; the views of Decode() and Separate() live as long as this.
struct Frames {
  std::map<std::string, Image<uint16_t>> by_pattern;
  Image<float> black;
  Image<double> true_column, true_row;  // NaN where the projector does not reach
  ColumnCode code = ColumnCode::kGray;

  [[nodiscard]] RawView View(const Pattern& pattern) const { return by_pattern.at(pattern.ToString()).view(); }
  [[nodiscard]] DecodeInput Decode(const ProjectorCalibration& projector, int period_px) const;
  [[nodiscard]] SeparationFrames Separate(int period_px) const;
};

inline constexpr int kPeriodPx = 8;
inline constexpr int kShifts = 4;

[[nodiscard]] Frames Shoot(const RigCalibration& rig, int projector, const Surface& surface, const Shot& shot);
// The surface itself, on the camera's (mono) sites.
[[nodiscard]] SurfaceMap TrueSurface(const RigCalibration& rig, const Surface& surface);

}  // namespace stratalux::fit
