// SPDX-License-Identifier: Apache-2.0
// LightWatch: looks at a dark, flat or response capture and says whether the light was as it should be, and if not,
// which exposure would do.
#pragma once

#include <vector>

#include "firmware-host/calibration/capture_fault.h"
#include "firmware-host/sequence/capture_observer.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

struct LightWatchOptions {
  SessionKind kind = SessionKind::kFlat;
  int projectors = 4;
  double saturation_dn = 4095.0;
  double exposure_ms = 16.0;
  double max_dark = 0.15;        // of the range: brighter than any black level
  double max_structure = 0.01;   // of the range, between the darkest and the brightest parts of a dark picture
  double max_saturated = 0.001;  // of a flat picture
  double least_white = 0.25;     // of the range, of the bright half of a flat picture
  double wanted_white = 0.75;
};

// Thread-bound. Judges the frames of the plan's nominal exposure.
class LightWatch : public CaptureObserver {
 public:
  explicit LightWatch(const LightWatchOptions& options);

  void OnFrame(const FrameRecord& record, const Image<uint16_t>& pixels) override;
  [[nodiscard]] std::vector<Finding> Objections() const override { return FindingsOf(Faults()); }
  [[nodiscard]] std::vector<CaptureFault> Faults() const;

 private:
  struct Levels {
    bool seen = false;
    double low = 0.0, middle = 0.0, high = 0.0;  // percentiles 1, 50 and 99 of block means, DN
    double bright = 0.0;                         // percentile 99 of single pixels
    double saturated = 0.0;                      // share of pixels
  };
  [[nodiscard]] Levels LevelsOf(const Image<uint16_t>& pixels) const;
  void JudgeDark(std::vector<CaptureFault>& faults) const;
  void JudgeWhite(int projector, std::vector<CaptureFault>& faults) const;

  LightWatchOptions options_;
  std::vector<Levels> white_, black_;  // by projector
};

}  // namespace stratalux::rig
