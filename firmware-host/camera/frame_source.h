// SPDX-License-Identifier: Apache-2.0
// FrameSource: the camera behind one interface (V4L2, libcamera and simulated back-ends).
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "shared/base/result.h"
#include "shared/image/image.h"
#include "shared/image/pixel_format.h"
#include "shared/units/time.h"

namespace stratalux::rig {

struct CapturedFrame {
  Image<uint16_t> pixels;
  PixelFormat format = PixelFormat::kMono12;
  Cfa cfa = Cfa::kRggb;
  int64_t sequence = 0;  // the driver's; a gap is a lost frame
  MonotonicNs time;      // start of exposure
  ClockSource clock = ClockSource::kUnknown;
  double exposure_ms = 0.0;  // as the camera reports it for this frame
  double gain = 1.0;
  bool corrupt = false;  // the driver's error flag
};

class FrameSource {
 public:
  virtual ~FrameSource() = default;
  // True: each TriggerCamera of the lines exposes one frame. False: the camera streams by itself (free_running).
  [[nodiscard]] virtual bool follows_trigger() const { return true; }
  virtual Status Start() = 0;
  virtual Status Stop() = 0;
  // Takes effect for the next exposure.
  virtual Status SetExposure(double exposure_ms, double gain) = 0;
  // Next frame; nullopt at the deadline.
  virtual Result<std::optional<CapturedFrame>> Wait(std::chrono::nanoseconds timeout) = 0;
};

}  // namespace stratalux::rig
