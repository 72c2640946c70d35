// SPDX-License-Identifier: Apache-2.0
// A kiosk that serves a visit in a blink: a small station, short seconds.
#pragma once

#include <filesystem>

#include "firmware-host/kiosk/kiosk.h"
#include "tests/firmware-host/session/small_station.h"

namespace stratalux::rig {

// The plane fills the frame: no edge is free of it.
inline KioskOptions SmallKiosk(const std::filesystem::path& folder) {
  KioskOptions options;
  options.station = SmallStation(folder);
  RigConfig& config = options.station.config;
  config.store.encrypt = true;
  config.kiosk.margin = 0.0;
  config.kiosk.countdown_s = 1;
  config.kiosk.steady_looks = 1;
  // Deadlines end no visit here: they count from 2 s on, however busy the machine is.
  for (int* seconds :
       {&config.kiosk.question_s, &config.kiosk.consent_s, &config.kiosk.position_s, &config.kiosk.capture_s,
        &config.kiosk.gate_s, &config.kiosk.thanks_s, &config.kiosk.forgetting_s, &config.kiosk.selfcheck_s})
    *seconds = 3600;
  options.second = std::chrono::milliseconds(20);
  return options;
}

}  // namespace stratalux::rig
