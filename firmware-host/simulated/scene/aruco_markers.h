// SPDX-License-Identifier: Apache-2.0
// The markers of ArUco's 4 x 4 dictionary of 50 (Garrido-Jurado et al., Pattern Recognition 47 (2014) 2280; OpenCV's
// DICT_4X4_50), for simulated ChArUco boards.
#pragma once

namespace stratalux::rig {

inline constexpr int kMarkers = 50;
inline constexpr int kMarkerCells = 4;  // per side, inside a black border one cell wide

// True for a white cell; `column`, `row`: 0 .. kMarkerCells + 1, border included.
[[nodiscard]] bool MarkerBit(int marker, int column, int row);

}  // namespace stratalux::rig
