// SPDX-License-Identifier: Apache-2.0
// The public captures of a real projector and camera (procam-calibration, MIT), where they are installed.
#pragma once

#include <filesystem>

#include "fitter/calibration/observations.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// $STRATALUX_DATA/procam_gray_kamino, else beside the repository; may be absent.
[[nodiscard]] std::filesystem::path RealBoardsFolder();
// Five poses, from the frames themselves: search, motion, decoding, look-up. No poses where the data are absent.
[[nodiscard]] Result<CalibrationObservations> ObserveRealBoards();

}  // namespace stratalux::fit
