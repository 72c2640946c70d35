// SPDX-License-Identifier: Apache-2.0
#include "shared/geometry/pinhole.h"

#include <Eigen/LU>
#include <cmath>
#include <string>

#include "shared/image/image.h"

namespace stratalux {
namespace {

// Brown 1966 as in OpenCV: normalised coordinates (x, y) -> distorted ones, with the Jacobian.
Eigen::Vector2d Distort(const std::array<double, 5>& d, const Eigen::Vector2d& n, Eigen::Matrix2d* jacobian) {
  const double x = n.x(), y = n.y();
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
  const double radial_slope = d[0] + r2 * (2.0 * d[1] + r2 * 3.0 * d[4]);  // d radial / d r2
  if (jacobian != nullptr) {
    (*jacobian)(0, 0) = radial + 2.0 * x * x * radial_slope + 2.0 * d[2] * y + 6.0 * d[3] * x;
    (*jacobian)(0, 1) = 2.0 * x * y * radial_slope + 2.0 * d[2] * x + 2.0 * d[3] * y;
    (*jacobian)(1, 0) = (*jacobian)(0, 1);
    (*jacobian)(1, 1) = radial + 2.0 * y * y * radial_slope + 6.0 * d[2] * y + 2.0 * d[3] * x;
  }
  return {x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x),
          y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y};
}

}  // namespace

std::optional<Eigen::Vector2d> Pinhole::Project(const Eigen::Vector3d& x_in_device) const {
  if (!(x_in_device.z() > 1e-9)) return std::nullopt;
  const Eigen::Vector2d n = Distort(distortion, x_in_device.head<2>() / x_in_device.z(), nullptr);
  return Eigen::Vector2d(fx * n.x() + cx, fy * n.y() + cy);
}

Eigen::Vector3d Pinhole::Unproject(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d target((pixel.x() - cx) / fx, (pixel.y() - cy) / fy);
  Eigen::Vector2d n = target;
  for (int i = 0; i < 20; ++i) {
    Eigen::Matrix2d jacobian;
    const Eigen::Vector2d error = Distort(distortion, n, &jacobian) - target;
    if (error.squaredNorm() < 1e-24) break;
    n -= jacobian.inverse() * error;
  }
  return Eigen::Vector3d(n.x(), n.y(), 1.0).normalized();
}

Status Pinhole::Validate() const {
  if (width <= 0 || height <= 0)
    return Status::Usage("size " + std::to_string(width) + "x" + std::to_string(height) + " must be positive");
  if (static_cast<uint64_t>(width) * static_cast<uint64_t>(height) > kMostImagePixels)
    return Status::Usage("size " + std::to_string(width) + "x" + std::to_string(height) + " has more than " +
                         std::to_string(kMostImagePixels) + " pixels");
  if (!(fx > 0.0) || !(fy > 0.0) || !std::isfinite(fx) || !std::isfinite(fy))
    return Status::Usage("focal lengths " + std::to_string(fx) + ", " + std::to_string(fy) + " px must be positive");
  for (double v : distortion)
    if (!std::isfinite(v)) return Status::Usage("distortion has a value that is not finite");
  return Status::Ok();
}

}  // namespace stratalux
