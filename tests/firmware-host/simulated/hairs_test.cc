// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/hairs.h"

#include <cmath>
#include <set>
#include <utility>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr double kCellMm = 0.04, kHalfWidthMm = 90.0, kHalfHeightMm = 110.0;

// The same hairs, sample by sample, as the header and hairs.cc describe them.
std::set<std::pair<int, int>> CellsOf(const HairField& field, uint64_t seed, uint64_t stream,
                                      const std::function<bool(double, double)>& region) {
  std::set<std::pair<int, int>> cells;
  const double pitch = 10.0 / std::sqrt(field.per_cm2);
  Random random(seed, stream);
  for (double y = -kHalfHeightMm; y < kHalfHeightMm; y += pitch)
    for (double x = -kHalfWidthMm; x < kHalfWidthMm; x += pitch) {
      const double root_x = x + pitch * random.Uniform(), root_y = y + pitch * random.Uniform();
      const double angle = field.direction_rad + random.Uniform(-0.5, 0.5);
      const double length = field.length_mm * random.Uniform(0.6, 1.0);
      if (!region(root_x, root_y)) continue;
      const double dx = std::cos(angle), dy = std::sin(angle), half = 0.5 * field.width_mm;
      for (double along = 0.0; along <= length; along += 0.5 * kCellMm)
        for (double across = -half; across <= half; across += 0.5 * kCellMm) {
          const double at_x = root_x + along * dx - across * dy, at_y = root_y + along * dy + across * dx;
          cells.emplace(std::floor((at_x + kHalfWidthMm) / kCellMm), std::floor((at_y + kHalfHeightMm) / kCellMm));
        }
    }
  return cells;
}

void ExpectSameCells(const HairField& field, uint64_t seed, double x_mm, double y_mm) {
  const auto region = [=](double x, double y) { return std::abs(x - x_mm) < 9.0 && std::abs(y - y_mm) < 9.0; };
  HairMap map;
  map.Grow(field, seed, 3, region);
  const auto cells = CellsOf(field, seed, 3, region);
  EXPECT_GT(cells.size(), 1000U);
  int covered = 0, missing = 0;
  const int first_column = static_cast<int>((x_mm + kHalfWidthMm - 15.0) / kCellMm),
            first_row = static_cast<int>((y_mm + kHalfHeightMm - 15.0) / kCellMm);
  for (int row = first_row; row < first_row + 750; ++row)
    for (int column = first_column; column < first_column + 750; ++column) {
      const double x = (column + 0.5) * kCellMm - kHalfWidthMm, y = (row + 0.5) * kCellMm - kHalfHeightMm;
      const bool hair = map.At(x, y) != SurfaceClass::kNone;
      covered += hair ? 1 : 0;
      const bool within = column >= 0 && row >= 0 && column < 4500 && row < 5500;
      missing += hair != (within && cells.contains({column, row})) ? 1 : 0;
    }
  EXPECT_GT(covered, 1000);
  EXPECT_EQ(missing, 0);
}

TEST(HairMap, CoversTheCellsOfEachSample) {
  ExpectSameCells({.per_cm2 = 800.0, .length_mm = 5.0, .width_mm = 0.2, .direction_rad = -1.5}, 1, 10.0, -70.0);
  ExpectSameCells({.per_cm2 = 60.0, .length_mm = 0.8, .width_mm = 0.11, .direction_rad = 1.2}, 2, -20.0, 60.0);
}

TEST(HairMap, EndsAtTheMapsEdge) {
  ExpectSameCells({.per_cm2 = 300.0, .length_mm = 4.0, .width_mm = 0.1, .direction_rad = -1.5}, 7, 84.0, -104.0);
}

}  // namespace
}  // namespace stratalux::rig
