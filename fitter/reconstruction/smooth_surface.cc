// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/smooth_surface.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>
#include <string>
#include <vector>

#include "fitter/reconstruction/components.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

struct Sample {
  Vector6 basis;         // 1, x, y, x^2, x y, y^2 about the centre, in window radii
  double inverse_depth;  // relative to the centre's: z0 / z - 1, so that depth errors are about -z0 times its errors
  double sigma;          // of inverse_depth
  double base_weight;    // distance weight / sigma^2
};

struct LocalFit {
  Vector6 coefficients;
  double sigma = 0.0;  // of the constant term
};

class Smoother {
 public:
  Smoother(const SurfaceMap& rough, const RigCalibration& rig, const SmoothOptions& options)
      : rough_(rough), options_(options) {
    const Pinhole& camera = rig.camera.model;
    quads_per_unit_ = camera.fx / QuadStep(rig.camera.cfa);
  }

  void SmoothQuad(int i, int j, SurfaceMap& out) const {
    const Eigen::Vector3d centre = rough_.Point(i, j);
    const std::vector<Sample> samples = Collect(i, j, centre);
    if (static_cast<int>(samples.size()) < options_.min_samples) return ForgetQuad(out, i, j);
    const auto fit = Fit(samples, centre.z());
    if (!fit) return ForgetQuad(out, i, j);

    const double q = (1.0 + fit->coefficients[0]) / centre.z();
    if (!(q > 0.0)) return ForgetQuad(out, i, j);
    const double scale = Radius(centre.z()) * centre.z();
    const Eigen::Vector2d n(centre.x() / centre.z(), centre.y() / centre.z());
    const Eigen::Vector2d slope(fit->coefficients[1] / scale, fit->coefficients[2] / scale);
    const Eigen::Vector3d normal = -Eigen::Vector3d(slope.x(), slope.y(), q - n.dot(slope)).normalized();
    const Eigen::Vector3d point = Eigen::Vector3d(n.x(), n.y(), 1.0) / q;
    for (int k = 0; k < 3; ++k) {
      out.point_mm(i, j, k) = static_cast<float>(point[k]);
      out.normal(i, j, k) = static_cast<float>(normal[k]);
    }
    out.depth_sigma_mm(i, j) = static_cast<float>(fit->sigma * point.norm());
  }

 private:
  // Window radius in normalised coordinates.
  [[nodiscard]] double Radius(double depth_mm) const { return options_.radius_mm / depth_mm; }

  [[nodiscard]] std::vector<Sample> Collect(int i, int j, const Eigen::Vector3d& centre) const {
    const double radius = Radius(centre.z());
    const int reach = static_cast<int>(std::ceil(radius * quads_per_unit_));
    std::vector<Sample> samples;
    for (int y = std::max(0, j - reach); y <= std::min(rough_.height() - 1, j + reach); ++y)
      for (int x = std::max(0, i - reach); x <= std::min(rough_.width() - 1, i + reach); ++x) {
        if (rough_.mask(x, y) == 0) continue;
        const Eigen::Vector3d p = rough_.Point(x, y);
        const double u = (p.x() / p.z() - centre.x() / centre.z()) / radius;
        const double v = (p.y() / p.z() - centre.y() / centre.z()) / radius;
        const double r2 = u * u + v * v;
        if (r2 > 1.0) continue;
        const double sigma_mm = rough_.depth_sigma_mm(x, y) * p.z() / p.norm();
        const double centre_sigma = rough_.depth_sigma_mm(i, j);
        const double allowed =
            options_.max_slope * std::sqrt(r2) * options_.radius_mm + 4.0 * std::hypot(sigma_mm, centre_sigma);
        if (std::abs(p.z() - centre.z()) > allowed) continue;
        const double sigma = sigma_mm * centre.z() / (p.z() * p.z());
        Sample s;
        s.basis << 1.0, u, v, u * u, u * v, v * v;
        s.inverse_depth = centre.z() / p.z() - 1.0;
        s.sigma = sigma;
        s.base_weight = std::exp(-2.0 * r2) / (sigma * sigma);
        samples.push_back(s);
      }
    return samples;
  }

  // Iterated least squares; the first round has no robust weights.
  [[nodiscard]] std::optional<LocalFit> Fit(const std::vector<Sample>& samples, double depth_mm) const {
    LocalFit fit{Vector6::Zero(), 0.0};
    for (int round = 0; round < options_.iterations; ++round) {
      Matrix6 normal = Matrix6::Zero(), spread = Matrix6::Zero();
      Vector6 right = Vector6::Zero();
      for (const Sample& s : samples) {
        double weight = s.base_weight;
        if (round > 0) {
          const double residual = s.inverse_depth - s.basis.dot(fit.coefficients);
          const double scale = std::max(options_.robust_floor_mm / depth_mm, 3.0 * s.sigma);
          const double damping = 1.0 / (1.0 + residual * residual / (scale * scale));
          weight *= damping * damping;
        }
        normal.selfadjointView<Eigen::Lower>().rankUpdate(s.basis, weight);
        spread.selfadjointView<Eigen::Lower>().rankUpdate(s.basis, weight * weight * s.sigma * s.sigma);
        right += weight * s.inverse_depth * s.basis;
      }
      const Eigen::LDLT<Matrix6> solver(normal);  // reads the lower half
      if (solver.info() != Eigen::Success || solver.rcond() < 1e-9) return std::nullopt;
      fit.coefficients = solver.solve(right);
      const Vector6 gain = solver.solve(Vector6::Unit(0));
      fit.sigma = std::sqrt(gain.dot(spread.selfadjointView<Eigen::Lower>() * gain));
    }
    if (!fit.coefficients.allFinite() || !std::isfinite(fit.sigma)) return std::nullopt;
    return fit;
  }

  const SurfaceMap& rough_;
  const SmoothOptions& options_;
  double quads_per_unit_ = 0.0;
};

}  // namespace

Status SmoothOptions::Validate() const {
  if (!(radius_mm > 0.0) || !(max_slope > 0.0) || !(robust_floor_mm > 0.0))
    return Status::Usage("smooth: radius, slope and robust floor must be positive");
  if (iterations < 1 || min_samples < 6)
    return Status::Usage("smooth: needs at least 1 iteration and 6 samples, has " + std::to_string(iterations) +
                         " and " + std::to_string(min_samples));
  return Status::Ok();
}

Result<SurfaceMap> SmoothSurface(const SurfaceMap& rough, const RigCalibration& rig, const SmoothOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SurfaceMap out = rough;
  const Smoother smoother(rough, rig, options);
  ParallelFor(rough.height(), 4, [&](int64_t begin, int64_t end) {
    for (int64_t j = begin; j < end; ++j)
      for (int i = 0; i < rough.width(); ++i)
        if (rough.mask(i, static_cast<int>(j)) != 0) smoother.SmoothQuad(i, static_cast<int>(j), out);
  });
  return out;
}

}  // namespace stratalux::fit
