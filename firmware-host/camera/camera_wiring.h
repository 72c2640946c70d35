// SPDX-License-Identifier: Apache-2.0
// Which camera, in which format, through which controls, as rig.toml says ([camera]; docs/hardware.md).
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "firmware-host/camera/camera_timing.h"

namespace stratalux::rig {

enum class CameraBackend : uint8_t { kNone, kV4l2, kLibcamera };
// The driver's control that sets it; kNone: the camera has none, and the exposure is `fixed_exposure_ms`.
enum class ExposureControl : uint8_t { kNone, kExposure, kExposureAbsolute };
enum class GainControl : uint8_t { kNone, kGain, kAnalogueGain };

// What starts an exposure: the pulse of the line bank, or the camera's own clock (sync mode free_running).
enum class CameraPace : uint8_t { kTriggered, kFreeRunning };

inline constexpr double kTransferMs = 15.0;

struct CameraWiring {
  CameraBackend backend = CameraBackend::kNone;
  // V4L2: a path that stays (/dev/v4l/by-id/...), or any of driver, card and bus as VIDIOC_QUERYCAP names them;
  // together they must fit exactly one device. libcamera: `device` is the camera's id.
  std::string device, driver, card, bus;
  std::string format;  // as the driver lists it, such as "Y12" or "BG12"; empty: the one that keeps most bits
  int width = 1392;    // px, of the mosaic
  int height = 1042;
  CameraPace pace = CameraPace::kTriggered;
  double frame_rate_hz = 0.0;  // of a camera that runs freely; 0: the driver's
  int buffers = 8;             // of the driver; a capture thread that is late by so many frames loses one
  // V4L2 alone: control value = exposure / exposure_unit_us, and gain * gain_unit.
  ExposureControl exposure_control = ExposureControl::kExposureAbsolute;
  double exposure_unit_us = 100.0;  // of V4L2_CID_EXPOSURE_ABSOLUTE; for V4L2_CID_EXPOSURE mostly the line time
  double fixed_exposure_ms = 0.0;
  GainControl gain_control = GainControl::kNone;
  double gain_unit = 1.0;
  // From the end of the exposure to the driver's time stamp, where that is taken at the end of a frame.
  double readout_ms = 0.0;
  // How soon it can be triggered again (camera_timing.h); `transfer_ms`: from the end of an exposure until its frame is
  // here, for estimates; unset: as a selftest learnt, else kTransferMs.
  ReadOut read_out = ReadOut::kSerial;
  double exposure_margin_ms = 1.0, min_frame_period_ms = 0.0;
  std::optional<double> transfer_ms;
  int reopen_tries = 10;  // in a row and half a second apart, after the device went or broke off
  // Figures of the sensor at gain 1, for the tolerance of single probes (pattern_witness.h).
  double gain_e_per_dn = 4.0;
  double read_noise_dn = 5.0;
  double saturation_dn = 4095.0;
};

}  // namespace stratalux::rig
