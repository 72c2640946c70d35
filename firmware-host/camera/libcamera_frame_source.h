// SPDX-License-Identifier: Apache-2.0
// LibcameraFrameSource: a camera that Linux drives through libcamera, as most on a single-board computer's ribbon
// cable.
//
//   number  the buffer's sequence, carried over its 32-bit wrap
//   time    start of exposure on CLOCK_MONOTONIC: the sensor time stamp where the camera gives one, else the buffer's
//           stamp - readout - exposure
//   values  exposure and gain as the frame's metadata report them; a camera without these controls has
//           [camera] fixed_exposure_ms and gain 1; one that takes them and reports nothing, what its request asked for
//   pixels  raw stream, as UnpackRaw gives it. BGR888 only if [camera] format names it: the green channel, 8 bits moved
//           to the upper ones of 12. Such pictures are processed (no linear light): for trying things out alone
//
// Where a device fails, libcamera can wait for ever, and 0.0.3 ends the process when it is asked to stop. So every call
// into it that may block has a deadline, and 5 s of waiting in vain for frames count as a failure. A camera that failed
// is left behind as it is, memory, descriptors and all: each further call says so. One that was unplugged can be opened
// again once it is back: libcamera's manager lives on and finds it. After a call that hung, this process opens no
// other.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "firmware-host/camera/camera_wiring.h"
#include "firmware-host/camera/frame_source.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct LibcameraFormat {
  std::string name;                        // libcamera's, for [camera] format
  std::vector<std::pair<int, int>> sizes;  // width, height, px
};

struct LibcameraDevice {
  std::string id, model;  // id: for [camera] device; model: of the sensor, empty where it does not say
  // Of the raw stream; of the processed one where the camera has none.
  std::vector<LibcameraFormat> formats;
};

class LibcameraFrameSource {
 public:
  // The cameras that libcamera finds; none is taken. kFailed: it does not start or answer; kUsage: this program was
  // built without libcamera. Reentrant.
  static Result<std::vector<LibcameraDevice>> List();
  // [camera] device is the camera's id as `stratalux-rig devices` lists it; empty where there is but one. kNotFound: no
  // such camera; kUsage: it lacks that format or size, or this program was built without libcamera; kBusy: another
  // program has it, or this process already has one. Thread-bound.
  static Result<std::unique_ptr<FrameSource>> Open(const CameraWiring& wiring, Logger& logger);
  // False: this program was built without libcamera.
  [[nodiscard]] static bool IsBuilt();
  // Whether libcamera lists the camera. True where nobody can tell, as long as this process never opened one.
  // Reentrant.
  [[nodiscard]] static bool IsThere(const CameraWiring& wiring);
};

}  // namespace stratalux::rig
