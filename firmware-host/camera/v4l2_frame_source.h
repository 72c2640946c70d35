// SPDX-License-Identifier: Apache-2.0
// V4l2FrameSource: a camera behind /dev/videoN, streaming into mapped buffers (V4L2, single-planar).
//
//   number  the driver's sequence, carried over its 32-bit wrap; a re-opened device counts on with a gap
//   time    start of exposure on CLOCK_MONOTONIC: the stamp itself, or stamp - readout - exposure where the driver
//           stamps the end of a frame. A driver that stamps with another clock gives frames of an unknown clock; a
//           stamp that jumped out of the stream marks its frame corrupt
//   pixels  grey or mosaic, 8 to 12 bits in the upper bits of 12 (Mono12), 16 bits as they are (Mono16)
//
// A device that broke off (EIO, ENODEV, hang-up) is closed, searched and opened again within the caller's deadline.
#pragma once

#include <memory>

#include "firmware-host/camera/camera_wiring.h"
#include "firmware-host/camera/frame_source.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

class V4l2FrameSource {
 public:
  // Finds and opens the camera and sets its format; no frame is taken before Start. kNotFound: no such camera; kUsage:
  // several fit, or it has neither that format nor that size. Thread-bound.
  static Result<std::unique_ptr<FrameSource>> Open(const CameraWiring& wiring, Logger& logger);
  // Whether a camera that fits is plugged in, whoever has it open. Reentrant.
  [[nodiscard]] static bool IsThere(const CameraWiring& wiring);
};

}  // namespace stratalux::rig
