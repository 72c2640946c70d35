// SPDX-License-Identifier: Apache-2.0
// Which parts of a picture a calibration board has covered: what a lens does where no corner was is a guess.
#pragma once

#include <bitset>
#include <string>

namespace stratalux::rig {

// 8 x 6 cells of a device's picture.
class CoverageMap {
 public:
  static constexpr int kColumns = 8, kRows = 6;

  // (x, y) as shares of the picture, 0 .. 1; outside: the nearest cell.
  [[nodiscard]] static int CellAt(double x, double y);
  void Cover(int cell) { cells_.set(static_cast<size_t>(cell)); }
  void Add(const CoverageMap& other) { cells_ |= other.cells_; }
  [[nodiscard]] bool Covers(int cell) const { return cells_.test(static_cast<size_t>(cell)); }
  // Of all cells, 0 .. 1.
  [[nodiscard]] double Share() const { return static_cast<double>(cells_.count()) / (kColumns * kRows); }
  // One row of the picture: '#' covered, '.' not.
  [[nodiscard]] std::string RowText(int row) const;

 private:
  std::bitset<size_t{kColumns} * kRows> cells_;
};

}  // namespace stratalux::rig
