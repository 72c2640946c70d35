// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/plate.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "firmware-host/simulated/scene/aruco_markers.h"
#include "firmware-host/simulated/scene/srgb.h"

namespace stratalux::rig {
namespace {

constexpr double kPlaneZ = 700.0;
constexpr double kWhiteAlbedo = 0.99;
constexpr double kMarginSquares = 1.0;  // white border around a board

bool IsBoard(ShapeKind kind) { return kind == ShapeKind::kCheckerboard || kind == ShapeKind::kCharuco; }

std::array<float, 3> Grey(double albedo) {
  const auto a = static_cast<float>(albedo);
  return {a, a, a};
}

}  // namespace

// sRGB of the patches: McCamy, Marcus, Davidson, "A color-rendition chart" (1976), as published for D65 by X-Rite.
// Reflectances in our three bands are taken as the linear sRGB values: a chart with known truth, not a spectral model.
const std::array<std::array<float, 3>, 24>& ColourChart() {
  static const auto chart = [] {
    constexpr int kSrgb[24][3] = {{115, 82, 68},   {194, 150, 130}, {98, 122, 157}, {87, 108, 67},   {133, 128, 177},
                                  {103, 189, 170}, {214, 126, 44},  {80, 91, 166},  {193, 90, 99},   {94, 60, 108},
                                  {157, 188, 64},  {224, 163, 46},  {56, 61, 150},  {70, 148, 73},   {175, 54, 60},
                                  {231, 199, 31},  {187, 86, 149},  {8, 133, 161},  {243, 243, 242}, {200, 200, 200},
                                  {160, 160, 160}, {122, 122, 121}, {85, 85, 85},   {52, 52, 52}};
    std::array<std::array<float, 3>, 24> albedo{};
    for (size_t i = 0; i < albedo.size(); ++i)
      for (size_t c = 0; c < 3; ++c) albedo[i][c] = static_cast<float>(LinearFromSrgb(kSrgb[i][c] / 255.0));
    return albedo;
  }();
  return chart;
}

Plate::Plate(ShapeKind kind, const PlateDescription& d)
    : kind_(kind), description_(d), width_mm_(d.width_mm), height_mm_(d.height_mm) {
  if (!IsBoard(kind)) return;
  width_mm_ = (d.columns + 2 * kMarginSquares) * d.square_mm;
  height_mm_ = (d.rows + 2 * kMarginSquares) * d.square_mm;
}

double Plate::Height(double x, double y) const {
  const bool inside = std::abs(x) <= 0.5 * width_mm_ && std::abs(y) <= 0.5 * height_mm_;
  return inside ? kPlaneZ : std::numeric_limits<double>::quiet_NaN();
}

std::optional<Eigen::Vector3d> Plate::Intersect(const Ray3& ray) const {
  if (ray.direction.z() <= 1e-9) return std::nullopt;
  const Eigen::Vector3d point = ray.origin_mm + ray.direction * ((kPlaneZ - ray.origin_mm.z()) / ray.direction.z());
  if (ray.origin_mm.z() >= kPlaneZ || std::isnan(Height(point.x(), point.y()))) return std::nullopt;
  return point;
}

// `column`, `row`: in squares from the upper left corner of the pattern. The upper left square is black; a ChArUco
// board's markers lie in its white squares, numbered row by row (OpenCV's layout from 4.6 on).
bool Plate::IsWhiteOnBoard(double column, double row) const {
  const int c = static_cast<int>(std::floor(column)), r = static_cast<int>(std::floor(row));
  if (c < 0 || r < 0 || c >= description_.columns || r >= description_.rows) return true;
  if ((c + r) % 2 == 0) return false;
  if (kind_ == ShapeKind::kCheckerboard) return true;
  const double side = description_.marker_mm / description_.square_mm, margin = 0.5 * (1.0 - side);
  const double u = (column - c - margin) / side, v = (row - r - margin) / side;
  if (u < 0.0 || v < 0.0 || u >= 1.0 || v >= 1.0) return true;
  int before = 0;  // white squares before this one
  for (int j = 0; j < r; ++j) before += (description_.columns + (j % 2 == 0 ? 0 : 1)) / 2;
  before += (c + (r % 2 == 0 ? 0 : 1)) / 2;
  return MarkerBit(before, static_cast<int>(u * (kMarkerCells + 2)), static_cast<int>(v * (kMarkerCells + 2)));
}

std::array<float, 3> Plate::Albedo(double x, double y) const {
  const PlateDescription& d = description_;
  const double u = x / width_mm_ + 0.5, v = y / height_mm_ + 0.5;
  switch (kind_) {
    case ShapeKind::kRamp: {  // from dark on the left to light on the right
      const int step = std::clamp(static_cast<int>(u * d.columns), 0, d.columns - 1);
      return Grey(d.dark_albedo + (d.light_albedo - d.dark_albedo) * step / (d.columns - 1));
    }
    case ShapeKind::kChart: {  // 6 x 4 patches on a dark board
      const double c = u * 6.0, r = v * 4.0;
      const double fc = c - std::floor(c), fr = r - std::floor(r);
      if (std::min(fc, 1.0 - fc) < 0.08 || std::min(fr, 1.0 - fr) < 0.08) return Grey(0.03);
      const auto patch =
          static_cast<size_t>(std::clamp(static_cast<int>(r), 0, 3) * 6 + std::clamp(static_cast<int>(c), 0, 5));
      return ColourChart()[patch];
    }
    case ShapeKind::kCheckerboard:
    case ShapeKind::kCharuco:
      return Grey(IsWhiteOnBoard(x / d.square_mm + 0.5 * d.columns, y / d.square_mm + 0.5 * d.rows) ? d.light_albedo
                                                                                                    : d.dark_albedo);
    default:
      return Grey(kWhiteAlbedo);
  }
}

Material Plate::MaterialAt(const Eigen::Vector3d& point, EyeLids /*lids*/) const {
  if (kind_ == ShapeKind::kSlab) return Material::Wax();
  return Material::Matt(Albedo(point.x(), point.y()));
}

}  // namespace stratalux::rig
