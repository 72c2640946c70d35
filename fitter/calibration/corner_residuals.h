// SPDX-License-Identifier: Apache-2.0
// Cost functors of the bundle adjustment (docs/math/calibration.md). Parameter blocks:
//   intrinsics[9]   fx fy cx cy k1 k2 p1 p2 k3        (px; OpenCV's order)
//   pose[6]         angle-axis, translation_mm        of camera_from_board or camera_from_projector
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>

#include <ceres/jet.h>
#include <ceres/rotation.h>

namespace stratalux::fit {

// Brown 1966: normalised coordinates -> distorted ones.
template <typename T>
Eigen::Matrix<T, 2, 1> DistortNormalised(const T* k, const Eigen::Matrix<T, 2, 1>& n) {
  const T x = n.x(), y = n.y(), r2 = x * x + y * y;
  const T radial = T(1.0) + r2 * (k[4] + r2 * (k[5] + r2 * k[8]));
  return {x * radial + T(2.0) * k[6] * x * y + k[7] * (r2 + T(2.0) * x * x),
          y * radial + k[6] * (r2 + T(2.0) * y * y) + T(2.0) * k[7] * x * y};
}

// False for points at or behind the device.
template <typename T>
bool ProjectPoint(const T* k, const Eigen::Matrix<T, 3, 1>& x_in_device, Eigen::Matrix<T, 2, 1>& pixel) {
  if (!(x_in_device.z() > T(1e-9))) return false;
  const Eigen::Matrix<T, 2, 1> n = DistortNormalised<T>(
      k, Eigen::Matrix<T, 2, 1>(x_in_device.x() / x_in_device.z(), x_in_device.y() / x_in_device.z()));
  pixel = {k[0] * n.x() + k[2], k[1] * n.y() + k[3]};
  return true;
}

[[nodiscard]] inline double ValueOf(double v) { return v; }
template <typename S, int N>
[[nodiscard]] double ValueOf(const ceres::Jet<S, N>& v) {
  return v.a;
}

// Distort() at n, and its slope there.
inline Eigen::Vector2d DistortWithSlope(const double* k, const Eigen::Vector2d& n, Eigen::Matrix2d& slope) {
  using Jet = ceres::Jet<double, 2>;
  Jet coefficients[9];
  for (int i = 0; i < 9; ++i) coefficients[i] = Jet(k[i]);
  const auto distorted = DistortNormalised<Jet>(coefficients, Eigen::Matrix<Jet, 2, 1>(Jet(n.x(), 0), Jet(n.y(), 1)));
  slope.row(0) = distorted.x().v.transpose();
  slope.row(1) = distorted.y().v.transpose();
  return {distorted.x().a, distorted.y().a};
}

// Normalised, undistorted coordinates of a pixel. Newton's method in plain numbers finds n; one more step of it, with
// derivatives, carries them exactly, for at the solution n' = -(dD/dn)^-1 (D' - target').
template <typename T>
Eigen::Matrix<T, 2, 1> UndistortPixel(const T* k, const Eigen::Vector2d& pixel) {
  constexpr int kMostIterations = 20;
  double values[9];
  for (int i = 0; i < 9; ++i) values[i] = ValueOf(k[i]);
  const Eigen::Vector2d target((pixel.x() - values[2]) / values[0], (pixel.y() - values[3]) / values[1]);
  Eigen::Vector2d n = target;
  Eigen::Matrix2d slope;
  for (int i = 0; i < kMostIterations; ++i) {
    const Eigen::Vector2d error = DistortWithSlope(values, n, slope) - target;
    if (error.squaredNorm() < 1e-24) break;
    n -= slope.inverse() * error;
  }
  const Eigen::Matrix<T, 2, 1> at(T(n.x()), T(n.y()));
  const Eigen::Matrix<T, 2, 1> error =
      DistortNormalised<T>(k, at) - Eigen::Matrix<T, 2, 1>((T(pixel.x()) - k[2]) / k[0], (T(pixel.y()) - k[3]) / k[1]);
  const Eigen::Matrix2d inverse = slope.inverse();
  return {at.x() - (T(inverse(0, 0)) * error.x() + T(inverse(0, 1)) * error.y()),
          at.y() - (T(inverse(1, 0)) * error.x() + T(inverse(1, 1)) * error.y())};
}

// A corner of the board as the camera sees it: projected less seen, in standard deviations.
struct CameraCornerResidual {
  Eigen::Vector2d board_mm, seen_px;
  double sigma_px = 1.0;

  template <typename T>
  bool operator()(const T* intrinsics, const T* camera_from_board, T* residual) const {
    const T on_board[3] = {T(board_mm.x()), T(board_mm.y()), T(0.0)};
    T turned[3];
    ceres::AngleAxisRotatePoint(camera_from_board, on_board, turned);
    const Eigen::Matrix<T, 3, 1> x(turned[0] + camera_from_board[3], turned[1] + camera_from_board[4],
                                   turned[2] + camera_from_board[5]);
    Eigen::Matrix<T, 2, 1> pixel;
    if (!ProjectPoint<T>(intrinsics, x, pixel)) return false;
    residual[0] = (pixel.x() - T(seen_px.x())) / T(sigma_px);
    residual[1] = (pixel.y() - T(seen_px.y())) / T(sigma_px);
    return true;
  }
};

// The projector pixel that lights what the camera pixel sees: the camera's ray meets the board's plane, the point is
// projected. The corner's own place on the board does not enter: an error in finding it moves camera pixel and
// projector pixel together, and this residual not at all.
struct TransferResidual {
  Eigen::Vector2d camera_px, projector_px;
  double sigma_px = 1.0;

  template <typename T>
  bool operator()(const T* camera, const T* projector, const T* camera_from_projector, const T* camera_from_board,
                  T* residual) const {
    const Eigen::Matrix<T, 2, 1> n = UndistortPixel<T>(camera, camera_px);
    const T z_axis[3] = {T(0.0), T(0.0), T(1.0)};
    T normal[3];
    ceres::AngleAxisRotatePoint(camera_from_board, z_axis, normal);
    // normal . (s (n, 1) - t) = 0
    const T* t = camera_from_board + 3;
    const T s =
        (normal[0] * t[0] + normal[1] * t[1] + normal[2] * t[2]) / (normal[0] * n.x() + normal[1] * n.y() + normal[2]);
    const T inverse[3] = {-camera_from_projector[0], -camera_from_projector[1], -camera_from_projector[2]};
    const T from_centre[3] = {s * n.x() - camera_from_projector[3], s * n.y() - camera_from_projector[4],
                              s - camera_from_projector[5]};
    T x[3];
    ceres::AngleAxisRotatePoint(inverse, from_centre, x);
    Eigen::Matrix<T, 2, 1> pixel;
    if (!ProjectPoint<T>(projector, Eigen::Matrix<T, 3, 1>(x[0], x[1], x[2]), pixel)) return false;
    residual[0] = (pixel.x() - T(projector_px.x())) / T(sigma_px);
    residual[1] = (pixel.y() - T(projector_px.y())) / T(sigma_px);
    return true;
  }
};

}  // namespace stratalux::fit
