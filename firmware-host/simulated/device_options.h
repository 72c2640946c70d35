// SPDX-License-Identifier: Apache-2.0
// What the simulated devices are like: optics, electronics, timing. The defaults are good devices without vices; a
// scene file's [camera], [projectors] (all of them), [[projector]] (one each, in order) and [timing] tables change
// them.
#pragma once

#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "firmware-host/camera/camera_timing.h"
#include "firmware-host/projector/memory_way.h"
#include "shared/base/result.h"
#include "shared/image/pixel_format.h"

namespace stratalux {
class TomlTable;
}

namespace stratalux::rig {

enum class Shutter { kGlobal, kRolling };

struct CameraElectronics {
  Cfa cfa = Cfa::kRggb;
  int bits = 12;  // 10 or 12; frames are always delivered in 12-bit containers
  std::array<double, 5> distortion = {-0.06, 0.05, 0.0, 0.0, 0.0};  // OpenCV order
  double black_level_dn = 64.0;
  double gain_e_per_dn = 4.0;
  double read_noise_dn = 3.0;
  double dark_current_e_per_s = 0.0;
  double prnu = 0.0;     // standard deviation of each pixel's sensitivity, relative
  double dsnu_dn = 0.0;  // standard deviation of each pixel's black level
  double hot_pixels_per_mpx = 0.0;
  double hot_dn_per_ms = 20.0;  // mean of their dark signal
  double vignetting = 0.0;      // 1: cos^4 of the field angle, 0: none
  double blur_px = 0.0;         // standard deviation of the lens's blur
  double blooming = 0.0;        // share of the charge above saturation that spills up and down the column
  double compression = 0.0;     // at saturation a signal reads this share less than linear
  Shutter shutter = Shutter::kGlobal;
  double line_time_us = 10.0;  // rolling shutter: from one row's start to the next
};

struct ProjectorOptics {
  std::array<double, 5> distortion = {-0.03, 0.02, 0.0, 0.0, 0.0};
  double blur_px = 0.5;                           // standard deviation in focus, projector pixels
  double focus_mm = 800.0;                        // distance from the projector that is in focus
  double defocus_px_per_mm = 0.0;                 // how the blur grows away from it
  std::array<double, 2> falloff = {-0.12, 0.02};  // ProjectorCalibration::falloff
  double gamma = 1.0;                             // light of grey level v: v^gamma
  double black_level = 0.002;                     // light of black over light of white
  double flicker = 0.0;                           // standard deviation of each frame's light, relative
  double lag_ms = 0.0;            // time constant of the step from one pattern to the next (LCD, colour wheel)
  double drift_per_minute = 0.0;  // of the lamp, relative
  // About its own axes (x right, y down, z forward), degrees: a projector that no longer stands as it was mounted.
  std::array<double, 3> turned_deg = {0.0, 0.0, 0.0};

  // Standard deviation of the blur at a distance from the projector.
  [[nodiscard]] double BlurPx(double distance_mm) const {
    return std::hypot(blur_px, defocus_px_per_mm * (distance_mm - focus_mm));
  }
};

struct RigTiming {
  double sync_delay_ms = 0.4;      // TRIGGER to light and SYNC edge
  double shutter_delay_ms = 0.02;  // TRIGGER to exposure
  double readout_ms = 8.0;
  // The camera exposes while the frame before is read out; an exposure may not end before that. Else it takes the next
  // trigger when the read-out has ended.
  bool overlapped_readout = false;
  double min_frame_period_ms = 0.0;  // from one triggered exposure's start to the next, whatever else allows
  double jitter_us = 0.0;            // standard deviation of each of the delays and of the read-out
  // A pattern memory's way to what is loaded (memory_way.h): RESET, and each step.
  double memory_reset_ms = 0.0;
  double memory_step_ms = 0.0;
  // Of a free-running camera; at least exposure and read-out, else these set the pace.
  double frame_period_ms = 33.3;
};

[[nodiscard]] MemoryTiming MemoryTimingOf(const RigTiming& timing);

// How soon the camera of that timing can be triggered again; what else the sequencer keeps to is as `configured`.
[[nodiscard]] CameraTiming CameraTimingOf(const RigTiming& timing, const CameraTiming& configured);

struct DeviceOptions {
  CameraElectronics camera;
  ProjectorOptics projector;                // what all share
  std::vector<ProjectorOptics> projectors;  // where given: each one's own
  RigTiming timing;

  [[nodiscard]] const ProjectorOptics& ForProjector(size_t p) const {
    return p < projectors.size() ? projectors[p] : projector;
  }
};

// Reads [camera], [projectors], [[projector]] and [timing] of `root`.
[[nodiscard]] Result<DeviceOptions> ReadDevices(TomlTable& root);

}  // namespace stratalux::rig
