// SPDX-License-Identifier: Apache-2.0
// The board poses of calibration sessions, as calibration wants them.
#pragma once

#include <string>
#include <vector>

#include "fitter/calibration/observe_board.h"
#include "fitter/session/quad_signal.h"
#include "fitter/session/session_frames.h"
#include "fitter/stages/decode.h"

namespace stratalux::fit {

struct BoardPoses {
  CalibrationObservations observations;
  CodeSize code;                              // of all sessions
  std::vector<std::string> left_out;          // poses that could not be used: name, cause, remedy
  std::optional<RigCalibration> calibration;  // the newest session's own record, if any
  std::vector<std::string> sessions;          // ids, oldest first
  // Of the sensor, as the newest session tells; by its frames' format only where no record says better. 0: not known.
  double saturation_dn = 0.0;
};

struct BoardStageOptions {
  BoardDescription board;
  ObserveOptions observe;
  // Of imports. Else as the record, the session's manifest or its plan say; where none does, all that the frames cover,
  // and all that the code can number (which is warned of).
  std::optional<DeviceSize> camera_size, projector_size;
};

// All poses of the sessions; a session without pose numbers is one pose; a pose that has a session to
// itself was captured again where a younger one of that number was, and is replaced by it, or stands where that could
// not be used. Fails where sessions do not belong together or hold no board pose at all.
[[nodiscard]] Result<BoardPoses> ObserveBoards(const std::string& store, const std::vector<std::string>& sessions,
                                               const BoardStageOptions& options, Logger& logger);

}  // namespace stratalux::fit
