// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>

#include "firmware-host/simulated/scene/shape.h"
#include "shared/base/parallel.h"

namespace stratalux::rig {
namespace {

constexpr double kExtentMm = 170.0;  // half-size of the tabulated square
constexpr double kCellMm = 0.5;
constexpr int kSquareCells = 16;
constexpr double kSquareMm = kSquareCells * kCellMm;
constexpr double kInFrontMm = 2.0;  // the table cuts off what stands out between its samples

// Of a square and the eight around it; one square more on each side than the table has.
Image<float> NearestOf(const Image<float>& table) {
  const int squares = (table.width() - 1 + kSquareCells - 1) / kSquareCells;
  Image<float> least(squares + 2, squares + 2, 1, std::numeric_limits<float>::infinity());
  for (int j = 0; j < table.height(); ++j)
    for (int i = 0; i < table.width(); ++i) {
      if (std::isnan(table(i, j))) continue;
      float& square = least(i / kSquareCells + 1, j / kSquareCells + 1);
      square = std::min(square, table(i, j));
    }
  Image<float> nearest = least;
  for (int j = 0; j < least.height(); ++j)
    for (int i = 0; i < least.width(); ++i)
      for (int v = std::max(0, j - 1); v <= std::min(least.height() - 1, j + 1); ++v)
        for (int u = std::max(0, i - 1); u <= std::min(least.width() - 1, i + 1); ++u)
          nearest(i, j) = std::min(nearest(i, j), least(u, v));
  return nearest;
}

// How far along a ray the squares around a point bound what lies ahead; a cell reaches into the next square.
double ReachMm(const Eigen::Vector3d& direction) {
  return (kSquareMm - kCellMm) / std::hypot(direction.x(), direction.y());
}

}  // namespace

void HeightField::Tabulate() {
  const int size = static_cast<int>(2 * kExtentMm / kCellMm) + 1;
  table_ = Image<float>(size, size);
  ParallelFor(size, 16, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < size; ++i)
        table_(i, j) = static_cast<float>(Height(-kExtentMm + i * kCellMm, -kExtentMm + j * kCellMm));
  });
  nearest_ = NearestOf(table_);
}

double HeightField::Tabulated(double x, double y) const {
  const double u = (x + kExtentMm) / kCellMm, v = (y + kExtentMm) / kCellMm;
  if (!(u >= 0 && v >= 0 && u < table_.width() - 1 && v < table_.height() - 1))
    return std::numeric_limits<double>::quiet_NaN();
  const int i = static_cast<int>(u), j = static_cast<int>(v);
  const double a = u - i, b = v - j;
  return (1 - a) * (1 - b) * table_(i, j) + a * (1 - b) * table_(i + 1, j) + (1 - a) * b * table_(i, j + 1) +
         a * b * table_(i + 1, j + 1);
}

double HeightField::FreeMm(const Eigen::Vector3d& point, double rise, double reach_mm) const {
  const double u = (point.x() + kExtentMm) / kSquareMm + 1.0, v = (point.y() + kExtentMm) / kSquareMm + 1.0;
  if (!(u >= 0.0 && v >= 0.0 && u < nearest_.width() && v < nearest_.height())) return reach_mm;
  const double ahead_mm = nearest_(static_cast<int>(u), static_cast<int>(v)) - kInFrontMm - point.z();
  if (ahead_mm <= 0.0) return 0.0;
  return rise > 0.0 ? std::min(reach_mm, ahead_mm / rise) : reach_mm;
}

std::optional<Eigen::Vector3d> HeightField::Intersect(const Ray3& ray) const {
  constexpr double kNear = 560.0, kFar = 800.0;  // the subject lies between these depths
  constexpr double kLeapMm = 2.0;
  if (ray.direction.z() <= 0.0) return std::nullopt;
  double t = std::max(0.0, (kNear - ray.origin_mm.z()) / ray.direction.z());
  const double t_end = (kFar - ray.origin_mm.z()) / ray.direction.z();
  const double reach_mm = ReachMm(ray.direction);
  double before = t;
  // Leap, then march: the gap to the surface, over the steepest slope that matters, bounds the step.
  while (t < t_end) {
    const Eigen::Vector3d p = ray.origin_mm + t * ray.direction;
    if (const double free_mm = FreeMm(p, ray.direction.z(), reach_mm); free_mm > kLeapMm) {
      before = t;
      t += free_mm;
      continue;
    }
    const double gap = Tabulated(p.x(), p.y()) - p.z();
    if (gap <= 0.0) break;
    before = t;
    t += std::isnan(gap) ? 1.0 : std::clamp(0.3 * gap, 0.25, 20.0);
  }
  if (t >= t_end) return std::nullopt;
  double low = std::max(0.0, before - 0.5), high = t + 0.5;
  // How far the ray at s lies below the surface; NaN where there is none.
  auto depth = [&](double s) {
    const Eigen::Vector3d p = ray.origin_mm + s * ray.direction;
    return p.z() - Height(p.x(), p.y());
  };
  double at_high = depth(high), at_low = depth(low);
  if (!(at_high >= 0.0)) return std::nullopt;
  if (at_low >= 0.0) {
    low = before - 4.0;
    at_low = depth(low);
  }
  // Regula falsi (Illinois); halves the range where the surface ends in it, or where there is no change of sign.
  constexpr double kExactMm = 1e-10;
  double weight_low = at_low, weight_high = at_high;
  for (int i = 0, side = 0; i < 60 && high - low > kExactMm && at_high > kExactMm; ++i) {
    double middle = 0.5 * (low + high);
    if (weight_low < 0.0) middle = std::clamp(low + (high - low) * weight_low / (weight_low - weight_high), low, high);
    const double at_middle = depth(middle);
    if (at_middle >= 0.0) {
      high = middle;
      at_high = weight_high = at_middle;
      if (side > 0) weight_low *= 0.5;
      side = 1;
    } else {
      low = middle;
      weight_low = at_middle;
      if (side < 0) weight_high *= 0.5;
      side = -1;
    }
  }
  // A ray that comes in behind the surface's edge meets no surface there.
  constexpr double kOnSurfaceMm = 1e-3;
  if (at_high > kOnSurfaceMm) return std::nullopt;
  return ray.origin_mm + high * ray.direction;
}

bool HeightField::Hides(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const {
  constexpr double kStep = 1.0, kSkip = 1.5, kSlack = 0.05;  // near its ends a line touches the surface anyway
  const Eigen::Vector3d line = to - from;
  const double length = line.norm(), rise = line.z() / length, reach_mm = ReachMm(line / length);
  for (double s = kSkip; s < length - kSkip;) {
    const Eigen::Vector3d p = from + line * (s / length);
    if (const double free_mm = FreeMm(p, rise, reach_mm); free_mm > kStep) {
      s += kStep * std::floor(free_mm / kStep);
      continue;
    }
    // The table cuts corners where the surface is steep.
    if (p.z() > Tabulated(p.x(), p.y()) + kSlack && p.z() > Height(p.x(), p.y()) + kSlack) return true;
    s += kStep;
  }
  return false;
}

Eigen::Vector3d HeightField::Normal(const Eigen::Vector3d& point) const {
  constexpr double kStep = 0.02;
  auto slope = [&](double dx, double dy) {
    const double plus = Height(point.x() + dx, point.y() + dy), minus = Height(point.x() - dx, point.y() - dy);
    if (!std::isnan(plus) && !std::isnan(minus)) return (plus - minus) / (2 * kStep);
    const double here = Height(point.x(), point.y());
    if (!std::isnan(plus)) return (plus - here) / kStep;
    return std::isnan(minus) ? 0.0 : (here - minus) / kStep;
  };
  return Eigen::Vector3d(slope(kStep, 0), slope(0, kStep), -1.0).normalized();
}

}  // namespace stratalux::rig
