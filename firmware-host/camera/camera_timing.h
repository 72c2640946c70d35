// SPDX-License-Identifier: Apache-2.0
// How soon a triggered camera can be triggered again, and when its exposure is over.
#pragma once

#include <chrono>
#include <cstdint>

namespace stratalux::rig {

enum class ReadOut : uint8_t {
  kSerial,      // a trigger during the read-out of a frame is lost: the frame is awaited first
  kOverlapped,  // the next frame is exposed while the last one is read out (global shutter)
};

struct CameraTiming {
  ReadOut read_out = ReadOut::kSerial;
  // From the planned end of an exposure to the projector's next TRIGGER: the camera's trigger delay and its jitter.
  std::chrono::nanoseconds exposure_margin = std::chrono::milliseconds(1);
  // From trigger to trigger at least; overlapped: the read-out of a frame, if that is longer than its exposure.
  std::chrono::nanoseconds min_frame_period = std::chrono::nanoseconds(0);
};

}  // namespace stratalux::rig
