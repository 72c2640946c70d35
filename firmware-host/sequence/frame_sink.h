// SPDX-License-Identifier: Apache-2.0
// FrameSink: where the sequencer hands proven frames. The recorder is one, tests bring their own.
#pragma once

#include "shared/base/result.h"
#include "shared/capture/frame_record.h"
#include "shared/image/image.h"

namespace stratalux::rig {

class FrameSink {
 public:
  virtual ~FrameSink() = default;
  // May block (a full queue). An error ends the capture: the sequencer switches all lines off and reports it.
  virtual Status Put(FrameRecord record, Image<uint16_t> pixels) = 0;
};

}  // namespace stratalux::rig
