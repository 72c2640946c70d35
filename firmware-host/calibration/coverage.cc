// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/calibration/coverage.h"

#include <algorithm>

namespace stratalux::rig {

int CoverageMap::CellAt(double x, double y) {
  const int column = std::clamp(static_cast<int>(x * kColumns), 0, kColumns - 1);
  const int row = std::clamp(static_cast<int>(y * kRows), 0, kRows - 1);
  return row * kColumns + column;
}

std::string CoverageMap::RowText(int row) const {
  std::string text;
  for (int column = 0; column < kColumns; ++column) text += Covers(row * kColumns + column) ? '#' : '.';
  return text;
}

}  // namespace stratalux::rig
