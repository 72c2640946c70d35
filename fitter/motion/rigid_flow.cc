// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/rigid_flow.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "shared/base/median.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

struct Seen {
  int x = 0, y = 0;
  Eigen::Vector3d point, normal;
  float log_light = 0.0F;
  double log_cos = 0.0;  // of the lamp's incidence
};

// The first picture at one scale, on bins of `bin` x `bin` quads.
struct Level {
  int bin = 1;
  Image<uint8_t> used;  // bins that are lit
  std::vector<Seen> seen;
  std::vector<Vector6> slopes;  // d residual / d motion, less its mean about the quad
};

// Geometry that all scales share.
struct Scene {
  const SurfaceMap& surface;
  const CameraCalibration& camera;
  Eigen::Vector3d light_mm, pivot;

  [[nodiscard]] double LogCos(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const {
    constexpr double kLeast = 0.05;
    return std::log(std::max(kLeast, normal.dot((light_mm - point).normalized())));
  }
};

double PixelsPerBin(const CameraCalibration& camera, int bin) { return double(QuadStep(camera.cfa)) * bin; }

// Position of a mosaic pixel on the bins.
Eigen::Vector2d OnBins(const CameraCalibration& camera, int bin, const Eigen::Vector2d& pixel) {
  const double size = PixelsPerBin(camera, bin);
  const double centre = (size - 1.0) / 2.0;
  return (pixel - Eigen::Vector2d::Constant(centre)) / size;
}

// Of Catmull and Rom, at 0 <= t < 1 between the second and the third of four.
std::array<double, 4> CubicWeights(double t) {
  const double t2 = t * t, t3 = t2 * t;
  return {-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2};
}

// NaN where one of the sixteen neighbours is.
double CubicAt(const Image<float>& image, const Eigen::Vector2d& at) {
  const int x = static_cast<int>(std::floor(at.x())), y = static_cast<int>(std::floor(at.y()));
  if (x < 1 || y < 1 || x + 2 >= image.width() || y + 2 >= image.height()) return std::nan("");
  const auto across = CubicWeights(at.x() - x), down = CubicWeights(at.y() - y);
  double sum = 0.0;
  for (int b = 0; b < 4; ++b)
    for (int a = 0; a < 4; ++a) sum += across[a] * down[b] * double(image(x + a - 1, y + b - 1));
  return sum;
}

Eigen::Vector3d BinPoint(const SurfaceMap& surface, int bin, int x, int y) {
  if (bin == 1) return surface.Point(x, y);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int known = 0;
  for (int b = 0; b < bin; ++b)
    for (int a = 0; a < bin; ++a)
      if (surface.mask(bin * x + a, bin * y + b) != 0) {
        sum += surface.Point(bin * x + a, bin * y + b);
        ++known;
      }
  return 2 * known >= bin * bin ? Eigen::Vector3d(sum / known) : Eigen::Vector3d::Constant(std::nan(""));
}

// Less the mean about each quad of those of `of` that are finite.
Image<float> Detail(const Image<float>& field, const Image<float>& of, double coarse_quads) {
  Image<float> detail = BlurredOver(of, coarse_quads);
  for (size_t i = 0; i < detail.size(); ++i) detail.pixels()[i] = field.pixels()[i] - detail.pixels()[i];
  return detail;
}

// Of a quad, before that: gradient of the light times the way that it goes in the picture, and what turning it in its
// light does, d log(n . l).
Vector6 SlopeOf(const Scene& scene, const Seen& seen, const Eigen::Vector2d& gradient_per_px) {
  const Pinhole& model = scene.camera.model;  // without its distortion, whose slope is a thousandth of it
  const double z = seen.point.z();
  Eigen::Vector3d by_point(gradient_per_px.x() * model.fx / z, gradient_per_px.y() * model.fy / z, 0.0);
  by_point.z() = -(by_point.x() * seen.point.x() + by_point.y() * seen.point.y()) / z;
  const Eigen::Vector3d to_light = scene.light_mm - seen.point, direction = to_light.normalized();
  const double cosine = std::max(0.05, seen.normal.dot(direction));
  const Eigen::Vector3d by_moving_in_light = (cosine * direction - seen.normal) / (to_light.norm() * cosine);
  by_point -= by_moving_in_light;
  Vector6 slope;
  slope << (seen.point - scene.pivot).cross(by_point) - seen.normal.cross(direction) / cosine, by_point;
  return slope;
}

Image<float> LightOn(const Level& level, const Image<float>& picture, const FlowOptions& options) {
  return LogLight(level.bin == 1 ? picture : Binned(picture, level.bin), level.used, options.fine_quads);
}

Level MakeLevel(const Scene& scene, int bin, const Image<float>& from, const Image<uint8_t>& lit,
                const FlowOptions& options) {
  Level level;
  level.bin = bin;
  level.used = Image<uint8_t>(from.width() / bin, from.height() / bin);
  Image<uint8_t>& used = level.used;
  for (int y = 0; y < used.height(); ++y)
    for (int x = 0; x < used.width(); ++x) {
      used(x, y) = 1;
      for (int b = 0; b < bin; ++b)
        for (int a = 0; a < bin; ++a)
          if (lit(bin * x + a, bin * y + b) == 0) used(x, y) = 0;
    }
  const Image<float> first = LightOn(level, from, options);
  Image<float> slopes(first.width(), first.height(), 6, std::nanf(""));
  const double per_px = 0.5 / PixelsPerBin(scene.camera, bin);
  for (int y = 1; y + 1 < first.height(); ++y)
    for (int x = 1; x + 1 < first.width(); ++x) {
      const Eigen::Vector2d gradient(per_px * (first(x + 1, y) - first(x - 1, y)),
                                     per_px * (first(x, y + 1) - first(x, y - 1)));
      const int i = bin * x + bin / 2, j = bin * y + bin / 2;
      Seen seen{x, y, BinPoint(scene.surface, bin, x, y), scene.surface.Normal(i, j), first(x, y), 0.0};
      if (!gradient.allFinite() || !std::isfinite(first(x, y)) || !seen.point.allFinite() || !seen.normal.allFinite())
        continue;
      seen.log_cos = scene.LogCos(seen.point, seen.normal);
      const Vector6 slope = SlopeOf(scene, seen, gradient);
      for (int k = 0; k < 6; ++k) slopes(x, y, k) = static_cast<float>(slope[k]);
      level.seen.push_back(seen);
    }
  const Image<float> detail = Detail(slopes, slopes, options.coarse_quads);
  for (const Seen& seen : level.seen) {
    Vector6& slope = level.slopes.emplace_back();
    for (int k = 0; k < 6; ++k) slope[k] = detail(seen.x, seen.y, k);
  }
  return level;
}

double RobustDeviation(const std::vector<double>& residuals) {
  std::vector<double> sizes;
  sizes.reserve(residuals.size());
  for (const double r : residuals)
    if (std::isfinite(r)) sizes.push_back(std::abs(r));
  return kMadToDeviation * Median(std::move(sizes));
}

std::vector<double> ValuesOf(const Level& level, const Image<float>& field) {
  std::vector<double> values;
  values.reserve(level.seen.size());
  for (const Seen& seen : level.seen) values.push_back(field(seen.x, seen.y));
  return values;
}

// Logarithm of the later picture `to` (LightOn) over what the first one, moved and turned in its light, would be, less
// its mean about each quad; NaN where the later one is not known.
std::vector<double> ResidualsOf(const Scene& scene, const Level& level, const Image<float>& to, const Rigid3& moved,
                                const FlowOptions& options) {
  Image<float> field(to.width(), to.height(), 1, std::nanf(""));
  ParallelFor(static_cast<int64_t>(level.seen.size()), 4096, [&](int64_t begin, int64_t end) {
    for (auto k = static_cast<size_t>(begin); k < static_cast<size_t>(end); ++k) {
      const Seen& seen = level.seen[k];
      const Eigen::Vector3d point = moved * seen.point;
      const auto pixel = scene.camera.model.Project(point);
      if (!pixel) continue;
      const double expected = double(seen.log_light) + scene.LogCos(point, moved.rotation * seen.normal) - seen.log_cos;
      field(seen.x, seen.y) = static_cast<float>(CubicAt(to, OnBins(scene.camera, level.bin, *pixel)) - expected);
    }
  });
  // A highlight that came or went is not to shift the mean about it.
  Image<float> detail = Detail(field, field, options.coarse_quads), used = field;
  const double limit = options.robust_scale * RobustDeviation(ValuesOf(level, detail));
  for (size_t i = 0; i < used.size(); ++i)
    if (!(std::abs(detail.pixels()[i]) < limit)) used.pixels()[i] = std::nanf("");
  detail = Detail(field, used, options.coarse_quads);
  return ValuesOf(level, detail);
}

// Its information, along each component.
Vector6 PriorOf(const FlowOptions& options) {
  Vector6 prior;
  prior << Eigen::Vector3d::Constant(std::pow(options.prior_turn_rad, -2)),
      Eigen::Vector3d::Constant(std::pow(options.prior_shift_mm, -2));
  return prior;
}

struct Solved {
  Vector6 motion;
  Matrix6 information;  // of the data, of unit variance
  int64_t quads = 0;
  double residual = 0.0;
};

// Gauss-Newton with Tukey's weights; the pictures' noise is that of their own residuals, of which a Gaussian of the
// detail's width makes one of 4 pi sigma^2.
Solved Solve(const Scene& scene, const Level& level, const Image<float>& to, const Vector6& guess,
             const FlowOptions& options) {
  const double alike = 4.0 * std::numbers::pi * options.fine_quads * options.fine_quads;
  const Vector6 prior = PriorOf(options);
  Solved solved{guess, Matrix6::Zero(), 0, 0.0};
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    const auto residuals = ResidualsOf(scene, level, to, SmallMotion::From(solved.motion).About(scene.pivot), options);
    solved.residual = std::max(1e-9, RobustDeviation(residuals));
    const double limit = options.robust_scale * solved.residual;
    const double per_unit = 1.0 / (alike * solved.residual * solved.residual);
    Matrix6 normal = Matrix6::Zero();
    Vector6 right = Vector6::Zero();
    solved.quads = 0;
    for (size_t k = 0; k < residuals.size(); ++k) {
      if (!(std::abs(residuals[k]) < limit)) continue;
      const double weight = std::pow(1.0 - std::pow(residuals[k] / limit, 2), 2);
      normal.noalias() += weight * level.slopes[k] * level.slopes[k].transpose();
      right -= weight * residuals[k] * level.slopes[k];
      ++solved.quads;
    }
    solved.information = per_unit * normal;
    const Matrix6 posterior = solved.information + Matrix6(prior.asDiagonal());
    const Vector6 step = posterior.ldlt().solve(Vector6(per_unit * right - prior.cwiseProduct(solved.motion)));
    solved.motion += step;
    if (step.head<3>().norm() * 100.0 + step.tail<3>().norm() < 1e-4) break;
  }
  return solved;
}

std::optional<RigidFlow> FlowOf(const Scene& scene, std::span<const Level> levels, const Image<float>& to,
                                const SmallMotion& guess, const FlowOptions& options) {
  const Level& fine = levels.back();
  const auto tells = [&](const Level& level) { return static_cast<int>(level.seen.size()) >= options.least_quads; };
  if (!tells(fine)) return std::nullopt;
  Vector6 motion = guess.Vector();
  for (const Level& coarse : levels.first(levels.size() - 1))
    if (tells(coarse)) motion = Solve(scene, coarse, LightOn(coarse, to, options), motion, options).motion;
  const Image<float> light = LightOn(fine, to, options);
  const Solved solved = Solve(scene, fine, light, motion, options);
  if (solved.quads < options.least_quads || !solved.motion.allFinite()) return std::nullopt;
  Vector6 model;
  model << Eigen::Vector3d::Constant(options.model_sigma_rad), options.model_sigma_mm, options.model_sigma_mm,
      options.model_sigma_depth_mm;
  RigidFlow flow;
  flow.motion = SmallMotion::From(solved.motion);
  flow.covariance = Matrix6(solved.information + Matrix6(PriorOf(options).asDiagonal())).inverse();
  flow.chi_squared = solved.motion.dot(Vector6(solved.information * solved.motion));
  flow.covariance += Matrix6(model.cwiseAbs2().asDiagonal());
  flow.quads = solved.quads;
  flow.residual = solved.residual;
  flow.residual_still = RobustDeviation(ResidualsOf(scene, fine, light, {}, options));
  return flow;
}

}  // namespace

Rigid3 SmallMotion::About(const Eigen::Vector3d& pivot) const {
  Rigid3 moved;
  if (const double angle = turn_rad.norm(); angle > 0.0)
    moved.rotation = Eigen::Quaterniond(Eigen::AngleAxisd(angle, turn_rad / angle));
  moved.translation_mm = pivot + shift_mm - moved.rotation * pivot;
  return moved;
}

Vector6 SmallMotion::Vector() const {
  Vector6 v;
  v << turn_rad, shift_mm;
  return v;
}

Status FlowOptions::Validate() const {
  if (!(fine_quads > 0.0) || !(coarse_quads > fine_quads) || coarse_quads > 100.0)
    return Status::Usage("motion: 0 < fine_quads < coarse_quads <= 100 is required");
  if (!(prior_shift_mm > 0.0) || !(prior_turn_rad > 0.0) || !(robust_scale > 0.0))
    return Status::Usage("motion: priors and robust_scale must be positive");
  return iterations > 0 && least_quads >= 6 ? Status::Ok()
                                            : Status::Usage("motion: iterations must be 1 or more, least_quads 6");
}

std::vector<std::optional<RigidFlow>> FindRigidFlows(const Image<float>& from, std::span<const Image<float>> later,
                                                     const Image<uint8_t>& lit, const SurfaceMap& surface,
                                                     const CameraCalibration& camera, const Eigen::Vector3d& light_mm,
                                                     const Eigen::Vector3d& pivot, const FlowOptions& options) {
  const Scene scene{surface, camera, light_mm, pivot};
  std::vector<Level> levels;  // the finest last
  if (from.width() > options.coarse_above_quads) levels.push_back(MakeLevel(scene, 4, from, lit, options));
  levels.push_back(MakeLevel(scene, 1, from, lit, options));
  std::vector<std::optional<RigidFlow>> flows;
  SmallMotion last;
  for (const Image<float>& to : later) {
    flows.push_back(FlowOf(scene, levels, to, last, options));
    if (flows.back()) last = flows.back()->motion;
  }
  return flows;
}

}  // namespace stratalux::fit
