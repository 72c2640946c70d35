// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/smooth_surface.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "fitter/reconstruction/components.h"
#include "fitter/reconstruction/surface_links.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

// Where a window's quads lie about its centre, the nearest first.
struct Offset {
  int dx = 0, dy = 0;
  int parent = 0;  // the quad before it on the way from the centre
  double radius = 0.0;
};

std::vector<Offset> OffsetsWithin(double radius) {
  const int reach = static_cast<int>(radius);
  std::vector<Offset> offsets;
  for (int dy = -reach; dy <= reach; ++dy)
    for (int dx = -reach; dx <= reach; ++dx)
      if (const double r = std::hypot(dx, dy); r <= radius) offsets.push_back({dx, dy, 0, r});
  std::stable_sort(offsets.begin(), offsets.end(), [](const auto& a, const auto& b) { return a.radius < b.radius; });
  for (Offset& o : offsets) {
    const int steps = std::max(std::abs(o.dx), std::abs(o.dy));
    if (steps == 0) continue;
    const int dx = o.dx - static_cast<int>(std::lround(static_cast<double>(o.dx) / steps));
    const int dy = o.dy - static_cast<int>(std::lround(static_cast<double>(o.dy) / steps));
    const auto at = std::ranges::find_if(offsets, [&](const Offset& p) { return p.dx == dx && p.dy == dy; });
    o.parent = static_cast<int>(at - offsets.begin());
  }
  return offsets;
}

// Of a window: columns that sums run along.
struct Samples {
  std::vector<double> x, y;           // from the centre, quads
  std::vector<double> inverse_depth;  // relative to the centre's: z0 / z - 1, its errors about -1 / z0 of the depth's
  std::vector<double> variance;       // of it
  std::vector<double> noise;          // the part of that which is independent from quad to quad
  std::vector<double> radius;         // quads
  std::vector<uint8_t> reached;       // of all offsets so far

  void Clear() {
    for (auto* column : {&x, &y, &inverse_depth, &variance, &noise, &radius}) column->clear();
    reached.clear();
  }
  [[nodiscard]] size_t size() const { return x.size(); }
};

using Column = Eigen::Map<const Eigen::ArrayXd>;
Column ColumnOf(const std::vector<double>& values, size_t count) {
  return {values.data(), static_cast<Eigen::Index>(count)};
}

// Sums of weight x^a y^b, a + b <= 4, as a quadratic's normal equations have them.
Matrix6 Moments(const Eigen::ArrayXd& w, const Column& x, const Column& y, Eigen::ArrayXd& wx, Eigen::ArrayXd& wy) {
  Matrix6 m;
  wx = w * x;
  wy = w * y;
  m(0, 0) = w.sum();
  m(1, 0) = wx.sum();
  m(2, 0) = wy.sum();
  m(3, 0) = m(1, 1) = (wx * x).sum();
  m(4, 0) = m(2, 1) = (wx * y).sum();
  m(5, 0) = m(2, 2) = (wy * y).sum();
  wx *= x;  // w x^2
  wy *= y;  // w y^2
  m(3, 1) = (wx * x).sum();
  m(3, 2) = m(4, 1) = (wx * y).sum();
  m(4, 2) = m(5, 1) = (wy * x).sum();
  m(5, 2) = (wy * y).sum();
  m(3, 3) = (wx * x * x).sum();
  m(4, 3) = (wx * x * y).sum();
  m(5, 3) = m(4, 4) = (wx * y * y).sum();
  m(5, 4) = (wy * x * y).sum();
  m(5, 5) = (wy * y * y).sum();
  return m.selfadjointView<Eigen::Lower>();
}

// Of a quadratic in x, y (quads): 1, x, y, x^2, x y, y^2.
struct LocalFit {
  Vector6 coefficients = Vector6::Zero();
  Eigen::Vector3d sigmas = Eigen::Vector3d::Zero();  // of the constant and the linear terms
  double smoothing_quads = 0.0;                      // of the slopes, SurfaceMap
};

class Smoother {
 public:
  Smoother(const SurfaceMap& rough, ImageView<const float> noise_sigma_mm, const RigCalibration& rig,
           const SmoothOptions& options)
      : rough_(rough),
        noise_sigma_mm_(noise_sigma_mm),
        camera_(rig.camera),
        options_(options),
        quads_per_unit_(rig.camera.model.fx / QuadStep(rig.camera.cfa)),
        offsets_(OffsetsWithin(options.max_radius_quads)),
        links_(rough) {}

  // False: the quad is dropped.
  bool SmoothQuad(int i, int j, SurfaceMap& out) const {
    const Eigen::Vector2d n = Direction(i, j);
    const double depth_mm = rough_.point_mm(i, j, 2);
    const auto fit = WidestThatAgrees(i, j, n, depth_mm);
    if (!fit) return false;
    const double q = (1.0 + fit->coefficients[0]) / depth_mm;
    if (!(q > 0.0)) return false;
    const Eigen::Vector3d point = Eigen::Vector3d(n.x(), n.y(), 1.0) / q;
    for (int k = 0; k < 3; ++k) out.point_mm(i, j, k) = static_cast<float>(point[k]);
    SetNormal(NormalTimesDistance(n, q, SlopeOf(*fit, depth_mm)), i, j, out);
    out.smoothing_quads(i, j) = static_cast<float>(fit->smoothing_quads);
    const double noise_mm = noise_sigma_mm_(i, j), all_mm = rough_.depth_sigma_mm(i, j);
    const double common_mm = std::sqrt(std::max(all_mm * all_mm - noise_mm * noise_mm, 0.0));
    out.depth_sigma_mm(i, j) = static_cast<float>(std::hypot(fit->sigmas[0] * point.norm(), common_mm));
    return true;
  }

  // A quadratic's depth errs by fourth derivatives, its slopes by third ones: the depths' own differences take the
  // place of its slopes along each axis that has both neighbours.
  void TakeDifferences(int i, int j, const SurfaceMap& once, SurfaceMap& out) const {
    const Eigen::Vector2d n = Direction(i, j);
    Eigen::Vector2d slope = InverseOf(once, i, j).head<2>();
    bool both = true;
    for (const auto& [dx, dy] : {std::pair(1, 0), std::pair(0, 1)}) {
      const bool reached = IsNext(once, i, j, i + dx, j + dy) && IsNext(once, i, j, i - dx, j - dy);
      both &= reached;
      if (!reached) continue;
      const Eigen::Vector3d ahead = once.Point(i + dx, j + dy), behind = once.Point(i - dx, j - dy);
      const Eigen::Vector2d step = ahead.hnormalized() - behind.hnormalized();
      slope += (1.0 / ahead.z() - 1.0 / behind.z() - slope.dot(step)) / step.squaredNorm() * step;
    }
    SetNormal(NormalTimesDistance(n, 1.0 / once.point_mm(i, j, 2), slope), i, j, out);
    if (both) out.smoothing_quads(i, j) = kBlurOfDifference;
  }

 private:
  [[nodiscard]] Eigen::Vector2d Direction(int i, int j) const {
    return camera_.model.Unproject(QuadCentre(camera_.cfa, i, j)).hnormalized();
  }
  [[nodiscard]] Eigen::Vector2d SlopeOf(const LocalFit& fit, double depth_mm) const {
    return fit.coefficients.segment<2>(1) * quads_per_unit_ / depth_mm;
  }
  // n' of the tangent plane: 1 = n' . X, that is q = n'_x x + n'_y y + n'_z.
  static Eigen::Vector3d NormalTimesDistance(const Eigen::Vector2d& n, double q, const Eigen::Vector2d& slope) {
    return {slope.x(), slope.y(), q - n.dot(slope)};
  }
  static Eigen::Vector3d InverseOf(const SurfaceMap& surface, int i, int j) {
    const Eigen::Vector3d normal = surface.Normal(i, j);
    return normal / normal.dot(surface.Point(i, j));
  }
  static void SetNormal(const Eigen::Vector3d& inverse, int i, int j, SurfaceMap& out) {
    const Eigen::Vector3d normal = -inverse.normalized();
    for (int k = 0; k < 3; ++k) out.normal(i, j, k) = static_cast<float>(normal[k]);
  }

  [[nodiscard]] bool IsNext(const SurfaceMap& once, int i, int j, int x, int y) const {
    return once.mask.contains(x, y) && once.mask(x, y) != 0 && links_.Linked(i, j, x, y);
  }

  // Adds what the window has within the radius.
  void Collect(int i, int j, const Eigen::Vector2d& n, double depth_mm, double radius, Samples& samples) const {
    for (size_t k = samples.reached.size(); k < offsets_.size() && offsets_[k].radius <= radius; ++k) {
      const Offset& o = offsets_[k];
      const Offset& from = offsets_[o.parent];
      const int x = i + o.dx, y = j + o.dy;
      const bool reached = k == 0 || (samples.reached[o.parent] != 0 && rough_.mask.contains(x, y) &&
                                      links_.Linked(i + from.dx, j + from.dy, x, y));
      samples.reached.push_back(reached ? 1 : 0);
      if (!reached) continue;
      const Eigen::Vector3d p = rough_.Point(x, y);
      const double of_depth = p.z() / p.norm() * depth_mm / (p.z() * p.z());
      samples.x.push_back((p.x() / p.z() - n.x()) * quads_per_unit_);
      samples.y.push_back((p.y() / p.z() - n.y()) * quads_per_unit_);
      samples.inverse_depth.push_back(depth_mm / p.z() - 1.0);
      samples.variance.push_back(std::pow(rough_.depth_sigma_mm(x, y) * of_depth, 2));
      samples.noise.push_back(std::pow(noise_sigma_mm_(x, y) * of_depth, 2));
      samples.radius.push_back(o.radius);
    }
  }

  // The intersection of confidence intervals, of the depth and of both slopes.
  [[nodiscard]] std::optional<LocalFit> WidestThatAgrees(int i, int j, const Eigen::Vector2d& n,
                                                         double depth_mm) const {
    thread_local Samples samples;
    samples.Clear();
    std::optional<LocalFit> widest;
    Eigen::Array3d low = Eigen::Array3d::Constant(-INFINITY), high = -low;
    for (double radius = options_.min_radius_quads; radius < 1.001 * options_.max_radius_quads; radius *= M_SQRT2) {
      const size_t before = samples.size();
      Collect(i, j, n, depth_mm, radius, samples);
      if (samples.size() < static_cast<size_t>(options_.min_samples)) break;
      if (samples.size() == before) continue;
      const auto fit = Fit(samples, radius, widest);
      if (!fit) break;
      const Eigen::Array3d value = fit->coefficients.head<3>(), reach = options_.agreement_sigmas * fit->sigmas.array();
      low = low.max(value - reach);
      high = high.min(value + reach);
      if ((low > high).any()) break;
      widest = fit;
    }
    return widest;
  }

  // Iterated least squares. What a narrower window says makes the robust weights; without, the first round has none.
  [[nodiscard]] std::optional<LocalFit> Fit(const Samples& samples, double radius,
                                            const std::optional<LocalFit>& narrower) const {
    const size_t count = samples.size();
    const Column x = ColumnOf(samples.x, count), y = ColumnOf(samples.y, count),
                 q = ColumnOf(samples.inverse_depth, count), variance = ColumnOf(samples.variance, count);
    const Vector6 scale(1.0, radius, radius, radius * radius, radius * radius, radius * radius);
    const Matrix6 unscaled = (scale * scale.transpose()).cwiseInverse();  // of sums, so that x, y are in radii
    thread_local Eigen::ArrayXd near, w, wx, wy;
    near = (ColumnOf(samples.radius, count) / radius).square();
    near = (-2.0 * near).exp() / variance;
    LocalFit fit = narrower.value_or(LocalFit{});
    for (int round = narrower ? kRounds - 1 : 0; round < kRounds; ++round) {
      w = near;
      if (round > 0) {
        const Vector6& c = fit.coefficients;
        wx = q - c[0] - x * (c[1] + c[3] * x + c[4] * y) - y * (c[2] + c[5] * y);
        w *= (1.0 + wx.square() / (variance * options_.robust_scale * options_.robust_scale)).square().inverse();
      }
      const Matrix6 normal = Moments(w, x, y, wx, wy).cwiseProduct(unscaled);
      const Eigen::LDLT<Matrix6> solver(normal);
      if (solver.info() != Eigen::Success || solver.rcond() < 1e-9) return std::nullopt;
      wx = w * q;
      Vector6 right;
      right << wx.sum(), (wx * x).sum(), (wx * y).sum(), (wx * x * x).sum(), (wx * x * y).sum(), (wx * y * y).sum();
      fit.coefficients = solver.solve(right.cwiseQuotient(scale)).cwiseQuotient(scale);
      if (round + 1 < kRounds) continue;
      const auto r2 = ColumnOf(samples.radius, count).square();
      fit.smoothing_quads = 0.5 * std::sqrt((w * r2 * r2).sum() / (w * r2).sum());
      w *= w * ColumnOf(samples.noise, count);
      const Matrix6 spread = Moments(w, x, y, wx, wy).cwiseProduct(unscaled);
      for (int k = 0; k < 3; ++k) {
        const Vector6 gain = solver.solve(Vector6::Unit(k));
        fit.sigmas[k] = std::sqrt(gain.dot(spread * gain)) / scale[k];
      }
    }
    if (!fit.coefficients.allFinite() || !fit.sigmas.allFinite()) return std::nullopt;
    return fit;
  }

  static constexpr int kRounds = 3;
  // To second order, as (12): a quadratic's depths have no blur, a difference over two quads that of 3^-1/2 quads.
  static constexpr float kBlurOfDifference = 0.577F;
  const SurfaceMap& rough_;
  const ImageView<const float> noise_sigma_mm_;
  const CameraCalibration& camera_;
  const SmoothOptions& options_;
  const double quads_per_unit_;
  const std::vector<Offset> offsets_;
  const SurfaceLinks links_;
};

}  // namespace

Status SmoothOptions::Validate() const {
  if (!(min_radius_quads >= 1.5) || !(max_radius_quads >= min_radius_quads) || !(max_radius_quads <= 64.0))
    return Status::Usage("smooth: windows must be 1.5 to 64 quads wide");
  if (!(agreement_sigmas > 0.0) || !(robust_scale > 0.0))
    return Status::Usage("smooth: sigmas and scales must be positive");
  if (min_samples < 6) return Status::Usage("smooth: a quadratic needs 6 samples, has " + std::to_string(min_samples));
  return Status::Ok();
}

Result<SurfaceMap> SmoothSurface(const SurfaceMap& rough, ImageView<const float> noise_sigma_mm,
                                 const RigCalibration& rig, const SmoothOptions& options, int64_t* dropped) {
  SLX_RETURN_IF_ERROR(options.Validate());
  if (noise_sigma_mm.width() != rough.width() || noise_sigma_mm.height() != rough.height())
    return Status::Usage("smooth: the deviations are of another surface");
  SurfaceMap out = rough;
  out.smoothing_quads = Image<float>(rough.width(), rough.height(), 1, std::nanf(""));
  const Smoother smoother(rough, noise_sigma_mm, rig, options);
  std::atomic<int64_t> count = 0;
  const auto for_all = [&](const auto& quad) {
    ParallelFor(rough.height(), 4, [&](int64_t begin, int64_t end) {
      for (int j = static_cast<int>(begin); j < end; ++j)
        for (int i = 0; i < rough.width(); ++i) quad(i, j);
    });
  };
  for_all([&](int i, int j) {
    if (rough.mask(i, j) == 0 || smoother.SmoothQuad(i, j, out)) return;
    ForgetQuad(out, i, j);
    ++count;
  });
  const SurfaceMap once = out;
  for_all([&](int i, int j) {
    if (once.mask(i, j) != 0) smoother.TakeDifferences(i, j, once, out);
  });
  if (dropped != nullptr) *dropped = count;
  return out;
}

}  // namespace stratalux::fit
