// SPDX-License-Identifier: Apache-2.0
// The public captures of a real projector and camera (procam-calibration, MIT), where they are installed.
#pragma once

#include <filesystem>
#include <vector>

#include "fitter/calibration/observations.h"
#include "fitter/structured_light/decoded_map.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// $STRATALUX_DATA/procam_gray_kamino, else beside the repository; may be absent.
[[nodiscard]] std::filesystem::path RealBoardsFolder();
// Five poses, from the frames themselves: search, motion, decoding, look-up. No poses where the data are absent.
[[nodiscard]] Result<CalibrationObservations> ObserveRealBoards();

// A pose as its codes say, of the crop that was kept of its pictures.
struct DecodedBoard {
  Eigen::Vector2d crop_px;  // where the crop lies in the camera's picture
  DecodedMap map;
  Image<uint8_t> lit;  // 1: white less black above 40
};
[[nodiscard]] Result<std::vector<DecodedBoard>> DecodeRealBoards();

}  // namespace stratalux::fit
