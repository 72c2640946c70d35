// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/depth_flow.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

#include "shared/base/median.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

struct Difference {
  Vector6 slope;  // d range / d motion
  double mm = 0.0, sigma_mm = 0.0;
};

}  // namespace

RangeMap RangesOf(const DecodedMap& decoded, const RigCalibration& rig, size_t projector) {
  const int step = QuadStep(rig.camera.cfa);
  const int width = decoded.reason.width() / step, height = decoded.reason.height() / step;
  RangeMap map{Image<float>(width, height, 1, std::nanf("")), Image<float>(width, height, 1, std::nanf(""))};
  const ProjectorCalibration& light = rig.projectors[projector];
  const Rigid3 projector_from_camera = light.camera_from_projector.Inverse();
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      double column = 0.0, variance = 0.0;
      for (int y = step * j; y < step * (j + 1); ++y)
        for (int x = step * i; x < step * (i + 1); ++x) {
          const bool valid = decoded.reason(x, y) == static_cast<uint8_t>(DecodeReason::kValid);
          column += valid ? double{decoded.column(x, y)} : std::nan("");
          variance += double{decoded.column_sigma(x, y)} * double{decoded.column_sigma(x, y)};
        }
      const double sites = step * step;
      column /= sites;
      if (!std::isfinite(column)) continue;
      // The plane that the column lights cuts the ray: n . (R t d + o) = 0 with n of the column in the projector.
      const Eigen::Vector3d ray = rig.camera.model.Unproject(QuadCentre(rig.camera.cfa, i, j)).normalized();
      const Eigen::Vector3d direction = projector_from_camera.rotation * ray;
      const Eigen::Vector3d& origin = projector_from_camera.translation_mm;
      const auto cut = [&](double at) {
        const double row = decoded.row(step * i, step * j);
        const Eigen::Vector3d light_ray =
            light.model.Unproject({at, std::isfinite(row) ? row : 0.5 * light.model.height});
        const double slope = light_ray.x() / light_ray.z();
        return (slope * origin.z() - origin.x()) / (direction.x() - slope * direction.z());
      };
      const double range = cut(column), per_column = cut(column + 0.5) - cut(column - 0.5);
      if (!(range > 0.0) || !std::isfinite(per_column)) continue;
      map.range_mm(i, j) = static_cast<float>(range);
      map.sigma_mm(i, j) = static_cast<float>(std::abs(per_column) * std::sqrt(variance) / sites);
    }
  return map;
}

std::optional<RigidFlow> FindDepthFlow(const RangeMap& a, const RangeMap& b, const SurfaceMap& surface,
                                       const Eigen::Vector3d& pivot, const DepthFlowOptions& options) {
  std::vector<Difference> seen;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0 || !std::isfinite(a.range_mm(i, j)) || !std::isfinite(b.range_mm(i, j))) continue;
      const Eigen::Vector3d point = surface.Point(i, j), normal = surface.Normal(i, j);
      const double facing = normal.dot(point.normalized());
      if (!(facing < -0.5)) continue;  // beyond 60 degrees a millimetre across is no small part of a slope
      Difference difference;
      difference.slope << (point - pivot).cross(normal) / facing, normal / facing;
      difference.mm = double{b.range_mm(i, j)} - double{a.range_mm(i, j)};
      difference.sigma_mm = std::hypot(double{a.sigma_mm(i, j)}, double{b.sigma_mm(i, j)});
      if (std::isfinite(difference.mm) && difference.sigma_mm > 0.0) seen.push_back(difference);
    }
  if (static_cast<int>(seen.size()) < options.least_quads) return std::nullopt;
  Vector6 weak;  // as good as no prior: metres and radians
  weak << Eigen::Vector3d::Constant(1.0), Eigen::Vector3d::Constant(1e-6);
  RigidFlow flow;
  Vector6 motion = Vector6::Zero();
  Matrix6 information = Matrix6::Zero();
  for (int iteration = 0; iteration < 20; ++iteration) {
    std::vector<double> sizes;
    for (const Difference& d : seen) sizes.push_back(std::abs(d.mm - d.slope.dot(motion)) / d.sigma_mm);
    const double scale = std::max(1.0, kMadToDeviation * Median(sizes)), limit = options.robust_scale * scale;
    if (iteration == 0) flow.residual_still = scale;
    Vector6 right = Vector6::Zero();
    information.setZero();
    flow.quads = 0;
    for (size_t k = 0; k < seen.size(); ++k) {
      if (!(sizes[k] < limit)) continue;
      const double weight = std::pow(1.0 - std::pow(sizes[k] / limit, 2), 2) / std::pow(seen[k].sigma_mm * scale, 2);
      information.noalias() += weight * seen[k].slope * seen[k].slope.transpose();
      right += weight * seen[k].mm * seen[k].slope;
      ++flow.quads;
    }
    const Vector6 next = (information + Matrix6(weak.asDiagonal())).ldlt().solve(right);
    const bool settled = (next - motion).tail<3>().norm() + 100.0 * (next - motion).head<3>().norm() < 1e-5;
    motion = next;
    flow.residual = scale;
    if (settled) break;
  }
  if (flow.quads < options.least_quads || !motion.allFinite()) return std::nullopt;
  Vector6 model;
  model << options.model_sigma_rad, options.model_sigma_rad, options.model_sigma_roll_rad,
      options.model_sigma_across_mm, options.model_sigma_across_mm, options.model_sigma_mm;
  flow.motion = SmallMotion::From(motion);
  flow.covariance = (information + Matrix6(weak.asDiagonal())).inverse() + Matrix6(model.cwiseAbs2().asDiagonal());
  return flow;
}

}  // namespace stratalux::fit
