// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include "fitter/srd/srd_extractor.h"
#include "shared/geometry/pixel_box.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

// Point where the ray through mosaic position `pixel` meets the plane (point, normal); `point` itself for a grazing
// ray.
Eigen::Vector3d OnPlane(const Pinhole& camera, const Eigen::Vector2d& pixel, const Eigen::Vector3d& point,
                        const Eigen::Vector3d& normal) {
  const Eigen::Vector3d ray = camera.Unproject(pixel);
  const double along = normal.dot(ray);
  if (std::abs(along) < 1e-3) return point;
  return ray * (normal.dot(point) / along);
}

// Gradient of the projector's column (axis 0) or row (1) in the tangent plane, per mm, as a 3-vector.
Eigen::Vector3d ColumnGradient(const ProjectorCalibration& projector, const Eigen::Vector3d& point,
                               const Eigen::Vector3d& normal, int axis_of_comb) {
  constexpr double kStepMm = 0.05;
  const Eigen::Vector3d a = normal.unitOrthogonal();
  const Eigen::Vector3d b = normal.cross(a);
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& axis : {a, b}) {
    const auto plus = projector.ProjectFromCamera(point + kStepMm * axis);
    const auto minus = projector.ProjectFromCamera(point - kStepMm * axis);
    if (!plus || !minus) return Eigen::Vector3d::Zero();
    gradient += ((*plus)[axis_of_comb] - (*minus)[axis_of_comb]) / (2.0 * kStepMm) * axis;
  }
  return gradient;
}

}  // namespace

SrdGeometry ComputeSrdGeometry(const RigCalibration& rig, int projector, const Eigen::Vector3d& point,
                               const Eigen::Vector3d& normal, const Eigen::Vector2d& pixel, int channel,
                               double exposure_ms, PatternAxis axis) {
  const ProjectorCalibration& light = rig.projectors[projector];
  const Cfa cfa = rig.camera.cfa;
  const int k = axis == PatternAxis::kColumns ? 0 : 1;
  SrdGeometry g;
  const Eigen::Vector3d omega_in = (light.CentreInCamera() - point).normalized();
  const Eigen::Vector3d omega_out = -point.normalized();
  g.cos_in = normal.dot(omega_in);
  g.cos_out = normal.dot(omega_out);
  if (!(g.cos_in > 0.0) || !(g.cos_out > 0.0)) return g;

  // Columns at the site and one mosaic pixel beside it, along the tangent plane.
  const Eigen::Vector2d site = pixel + QuadSiteOffset(cfa, channel);
  const Eigen::Vector3d at_site = OnPlane(rig.camera.model, site, point, normal);
  const auto c = light.ProjectFromCamera(at_site);
  const auto c_x = light.ProjectFromCamera(OnPlane(rig.camera.model, site + Eigen::Vector2d(1, 0), point, normal));
  const auto c_y = light.ProjectFromCamera(OnPlane(rig.camera.model, site + Eigen::Vector2d(0, 1), point, normal));
  const Eigen::Vector3d gradient = ColumnGradient(light, at_site, normal, k);
  if (!c || !c_x || !c_y || !(gradient.norm() > 1e-6)) return g;
  g.column = (*c)[k];
  g.mm_per_column = 1.0 / gradient.norm();
  const Eigen::Vector3d e = gradient * g.mm_per_column;
  g.across_line = e;
  const Eigen::Vector3d across = normal.cross(e);

  // t(omega) = omega / (n . omega) - n is tangential, so t . e = omega . e / (n . omega).
  g.slope_in = omega_in.dot(e) / g.cos_in;
  g.slope_out = omega_out.dot(e) / g.cos_out;
  g.slope_in_across = omega_in.dot(across) / g.cos_in;
  g.slope_out_across = omega_out.dot(across) / g.cos_out;

  // Blur in columns^2: the projector's, and through dC/dx, dC/dy the camera's and its pixel's box.
  const double dx = (*c_x)[k] - (*c)[k];
  const double dy = (*c_y)[k] - (*c)[k];
  const double per_axis = rig.camera.line_blur_px * rig.camera.line_blur_px + kBoxVariance;
  const double optics2 = light.line_blur_px * light.line_blur_px;
  double columns2 = optics2 + per_axis * (dx * dx + dy * dy);
  const auto half_box_mm = [&](double d) {
    if (!IsLongBox(d, optics2)) return 0.0;
    columns2 -= (kBoxVariance - kHalfBoxVariance) * d * d;
    return kHalfBoxPlace * d * g.mm_per_column;
  };
  g.box_x_mm = half_box_mm(dx);
  g.box_y_mm = half_box_mm(dy);
  g.blur_mm = std::sqrt(std::max(columns2, 0.0)) * g.mm_per_column;
  g.quad_x_mm = QuadStep(cfa) * dx * g.mm_per_column;
  g.quad_y_mm = QuadStep(cfa) * dy * g.mm_per_column;
  const auto sites = QuadSites(cfa, channel);
  const Eigen::Vector2d half = (sites.back() - sites.front()) / 2.0;
  g.pair_mm = std::abs(half.x() * dx + half.y() * dy) * g.mm_per_column;
  g.white_dn = light.WhiteTargetDn(at_site, normal, channel, exposure_ms);
  return g;
}

SurfaceMap PoolSurface(const SurfaceMap& surface, int pool) {
  if (pool == 1) return surface;
  const int width = surface.width() / pool;
  const int height = surface.height() / pool;
  const float nan = std::nanf("");
  SurfaceMap out{Image<float>(width, height, 3, nan), Image<float>(width, height, 3, nan),
                 Image<float>(width, height, 1, nan), Image<uint8_t>(width, height)};
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      Eigen::Vector3d point = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
      double variance = 0.0;
      int count = 0;
      for (int j = y * pool; j < (y + 1) * pool; ++j)
        for (int i = x * pool; i < (x + 1) * pool; ++i) {
          if (surface.mask(i, j) == 0) continue;
          point += surface.Point(i, j);
          normal += surface.Normal(i, j);
          variance += surface.depth_sigma_mm(i, j) * surface.depth_sigma_mm(i, j);
          ++count;
        }
      if (2 * count < pool * pool || !(normal.norm() > 0.0)) continue;
      point /= count;
      normal.normalize();
      for (int k = 0; k < 3; ++k) {
        out.point_mm(x, y, k) = static_cast<float>(point[k]);
        out.normal(x, y, k) = static_cast<float>(normal[k]);
      }
      out.depth_sigma_mm(x, y) = static_cast<float>(std::sqrt(variance) / count);
      out.mask(x, y) = 1;
    }
  return out;
}

}  // namespace stratalux::fit
