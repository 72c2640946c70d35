// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/hairs.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr double kHairCellMm = 0.04;                          // finer than a hair is wide
constexpr double kHalfWidthMm = 90.0, kHalfHeightMm = 110.0;  // a face

int CellOf(double at_mm, double half_mm) { return static_cast<int>(std::floor((at_mm + half_mm) / kHairCellMm)); }

// Cells in 2^-32. A sum of two such parts tells the cell of a sample, but for one so close to a cell's border that
// rounding may decide: of two units. Taken for close is far more, which costs nothing.
constexpr int kFractionBits = 32;
constexpr int64_t kDoubt = int64_t{1} << 20;
int64_t FixedOf(double cells) { return static_cast<int64_t>(cells * static_cast<double>(int64_t{1} << kFractionBits)); }
bool IsDoubtful(int64_t fixed) { return static_cast<uint32_t>(fixed + kDoubt) < 2 * kDoubt; }

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

// A head has 40,000 hairs of some 2,700 samples. The cells are those of CellOf for each sample, which costs four times
// as long.
void HairMap::Draw(double x, double y, double angle_rad, double length_mm, const HairField& field) {
  constexpr double kStepMm = 0.5 * kHairCellMm;
  const double dx = std::cos(angle_rad), dy = std::sin(angle_rad), half = 0.5 * field.width_mm;
  const auto surface = static_cast<uint8_t>(field.surface);
  middle_.clear();
  for (double along = 0.0; along <= length_mm; along += kStepMm) {
    const double at_x = x + along * dx, at_y = y + along * dy;
    middle_.push_back(
        {at_x, at_y, FixedOf((at_x + kHalfWidthMm) / kHairCellMm), FixedOf((at_y + kHalfHeightMm) / kHairCellMm)});
  }
  // A hair is straight: where its ends are well within the map, all of it is.
  const int margin = static_cast<int>(half / kHairCellMm) + 2;
  const auto is_inside = [&](const Sample& end) {
    const int column = static_cast<int>(end.column >> kFractionBits), row = static_cast<int>(end.row >> kFractionBits);
    return covered_.contains(column - margin, row - margin) && covered_.contains(column + margin, row + margin);
  };
  const bool inside = is_inside(middle_.front()) && is_inside(middle_.back());
  uint8_t* const cells = covered_.data();
  const int64_t width = covered_.width();
  for (double across = -half; across <= half; across += kStepMm) {
    const int64_t columns = FixedOf(across * dy / kHairCellMm), rows = FixedOf(across * dx / kHairCellMm);
    for (const Sample& sample : middle_) {
      const int64_t column = sample.column - columns, row = sample.row + rows;
      if (inside && !IsDoubtful(column) && !IsDoubtful(row)) [[likely]] {
        cells[(row >> kFractionBits) * width + (column >> kFractionBits)] = surface;
        continue;
      }
      const int at_column = CellOf(sample.x_mm - across * dy, kHalfWidthMm);
      const int at_row = CellOf(sample.y_mm + across * dx, kHalfHeightMm);
      if (covered_.contains(at_column, at_row)) covered_(at_column, at_row) = surface;
    }
  }
}

SurfaceClass HairMap::At(double x, double y) const {
  const int column = CellOf(x, kHalfWidthMm), row = CellOf(y, kHalfHeightMm);
  return covered_.contains(column, row) ? static_cast<SurfaceClass>(covered_(column, row)) : SurfaceClass::kNone;
}

}  // namespace stratalux::rig
