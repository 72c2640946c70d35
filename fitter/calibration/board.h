// SPDX-License-Identifier: Apache-2.0
// A flat calibration board: a chessboard, or a ChArUco board with markers of ArUco's 4x4 dictionary of 50.
#pragma once

#include <Eigen/Core>
#include <string>

#include "shared/base/result.h"

namespace stratalux::fit {

enum class BoardKind { kChess, kCharuco };
[[nodiscard]] const char* ToString(BoardKind kind);
[[nodiscard]] Result<BoardKind> ParseBoardKind(const std::string& text);

// That a device must see of a board to place it in a pose.
inline constexpr int kLeastCorners = 6;

// Board frame: origin at the first inner corner, +x along a row of corners, +y along a column, +z into the board, mm.
struct BoardDescription {
  BoardKind kind = BoardKind::kCharuco;
  int columns = 10, rows = 7;  // squares
  double square_mm = 20.0;
  double marker_mm = 15.0;  // ChArUco: side of a marker

  // kUsage: fewer than 3 squares a side or kLeastCorners, a size that is not positive, a marker that does not fit, too
  // many markers.
  [[nodiscard]] Status Validate() const;
  [[nodiscard]] int corner_columns() const { return columns - 1; }
  [[nodiscard]] int corners() const { return (columns - 1) * (rows - 1); }
  // Of inner corner `id`, row by row.
  [[nodiscard]] Eigen::Vector2d CornerMm(int id) const {
    return Eigen::Vector2d(id % corner_columns(), id / corner_columns()) * square_mm;
  }
};

}  // namespace stratalux::fit
