// SPDX-License-Identifier: Apache-2.0
// The surface as points with their covariance.
//
// A quad is seen along one ray r (unit, from the camera's centre through the point x), along which its depth has the
// standard deviation sigma (depth_sigma_mm). Across the ray the point stands for the whole quad: its place there is
// known to be somewhere on the quad's footprint, a square of side a = step z / sqrt(fx fy), evenly. So
//   C = sigma^2 r r^T + a^2 / 12 (I - r r^T)
// with r^T C r = sigma^2. Of a surface that the sweeps have placed (docs/math/offset.md), sigma holds what that leaves
// open, too, which all quads share; errors of the calibration are in neither. Lens distortion and the foreshortening of
// pixels off the axis change a by a few per cent, and are left out. A simulation's true surface has sigma 0.
#pragma once

#include <Eigen/Core>

#include "fitter/export/triangle_mesh.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

[[nodiscard]] Eigen::Matrix3d PointCovariance(const Eigen::Vector3d& point_mm, double depth_sigma_mm,
                                              const CameraCalibration& camera);

// One point a known quad, row by row. `normal_sigma_rad`: W x H, NaN where not known; empty: nowhere.
[[nodiscard]] PointCloud CloudFromSurface(const SurfaceMap& surface, const CameraCalibration& camera,
                                          ImageView<const float> normal_sigma_rad);

}  // namespace stratalux::fit
