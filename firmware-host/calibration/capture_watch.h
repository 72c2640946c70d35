// SPDX-License-Identifier: Apache-2.0
// CaptureWatch: looks at a session's frames on their way to the store, and may object before the session ends.
#pragma once

#include <string>
#include <vector>

#include "shared/capture/frame_record.h"
#include "shared/image/image.h"

namespace stratalux::rig {

// Something that an operator can mend.
struct CaptureFault {
  std::string what, remedy;
  bool by_chance = false;  // another try with nothing changed may go well
};

// Used by the capturing thread alone.
class CaptureWatch {
 public:
  virtual ~CaptureWatch() = default;
  // Each frame that the sequencer hands on, in the order of the shots.
  virtual void See(const FrameRecord& record, const Image<uint16_t>& pixels) = 0;
  // After the last frame: why the session is worth less than its proofs say. Empty: nothing.
  [[nodiscard]] virtual std::vector<CaptureFault> Faults() const = 0;
};

}  // namespace stratalux::rig
