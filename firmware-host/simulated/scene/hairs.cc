// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/hairs.h"

#include <algorithm>
#include <cmath>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr double kHairCellMm = 0.04;                          // finer than a hair is wide
constexpr double kHalfWidthMm = 90.0, kHalfHeightMm = 110.0;  // a face

int CellOf(double at_mm, double half_mm) { return static_cast<int>(std::floor((at_mm + half_mm) / kHairCellMm)); }

}  // namespace

void HairMap::Grow(const HairField& field, uint64_t seed, uint64_t stream,
                   const std::function<bool(double, double)>& region) {
  if (covered_.empty())
    covered_ = Image<uint8_t>(static_cast<int>(2 * kHalfWidthMm / kHairCellMm),
                              static_cast<int>(2 * kHalfHeightMm / kHairCellMm));
  const double pitch = 10.0 / std::sqrt(field.per_cm2);
  Random random(seed, stream);
  for (double y = -kHalfHeightMm; y < kHalfHeightMm; y += pitch)
    for (double x = -kHalfWidthMm; x < kHalfWidthMm; x += pitch) {
      const double root_x = x + pitch * random.Uniform(), root_y = y + pitch * random.Uniform();
      const double angle = field.direction_rad + random.Uniform(-0.5, 0.5);
      const double length = field.length_mm * random.Uniform(0.6, 1.0);
      if (region(root_x, root_y)) Draw(root_x, root_y, angle, length, field);
    }
}

void HairMap::Draw(double x, double y, double angle_rad, double length_mm, const HairField& field) {
  const double dx = std::cos(angle_rad), dy = std::sin(angle_rad), half = 0.5 * field.width_mm;
  for (double along = 0.0; along <= length_mm; along += 0.5 * kHairCellMm)
    for (double across = -half; across <= half; across += 0.5 * kHairCellMm) {
      const int column = CellOf(x + along * dx - across * dy, kHalfWidthMm);
      const int row = CellOf(y + along * dy + across * dx, kHalfHeightMm);
      if (covered_.contains(column, row)) covered_(column, row) = static_cast<uint8_t>(field.surface);
    }
}

SurfaceClass HairMap::At(double x, double y) const {
  const int column = CellOf(x, kHalfWidthMm), row = CellOf(y, kHalfHeightMm);
  return covered_.contains(column, row) ? static_cast<SurfaceClass>(covered_(column, row)) : SurfaceClass::kNone;
}

}  // namespace stratalux::rig
