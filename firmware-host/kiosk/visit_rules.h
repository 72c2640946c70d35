// SPDX-License-Identifier: Apache-2.0
// What the kiosk's machine decides by. Seconds are the shell's: KioskConfig::seconds.
#pragma once

#include <cstdint>

#include "firmware-host/kiosk/visit_events.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct VisitRules {
  int attempts = 3;          // of a visit: the first, and two retakes
  int countdown = 3;         // seconds
  int steady_looks = 2;      // pre-scans in a row that find a face where it should be
  int64_t space_bytes = 0;   // that all attempts of a visit may take
  int calibration_days = 0;  // a calibration that is older closes the kiosk; 0: any age is good
  // The text was agreed to on paper: START answers the question and agrees, to `paper`.
  bool paper_consent = false;
  ConsentChoice paper = {true, false, false, 0, 0};
  // Of a face's box, in thousandths of the frame: smallest distance from its edges, smallest height, furthest that the
  // middle may lie from the frame's.
  int margin_permille = 10, height_permille = 250, off_centre_permille = 120;
  int nearest_mm = 0, furthest_mm = 0;  // 0: no limit
  int level_permille = 500;             // of the wanted signal-to-noise ratio: below, nothing is captured
  int shortest_exposure_us = 500;       // a saturated capture is not shot again below it
  int most_saturated_permille = 10, least_coverage_permille = 700;  // of a capture

  // kUsage for what leaves no way through a visit; names the key of [kiosk].
  [[nodiscard]] Status Validate() const;
};

}  // namespace stratalux::rig
