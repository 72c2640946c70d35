// SPDX-License-Identifier: Apache-2.0
// The kiosk: one loop that performs what the machine (visit_machine.h) asks for on an open rig and its store, and tells
// it what came of it.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>

#include "db/privacy/forget.h"
#include "firmware-host/kiosk/kiosk_front.h"
#include "firmware-host/kiosk/visit_rules.h"
#include "firmware-host/kiosk/visit_state.h"
#include "firmware-host/session/capture_station.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct KioskOptions {
  StationOptions station;  // with [kiosk]
  VisitTiming timing;
  // Of the deadlines; tests have shorter ones.
  std::chrono::nanoseconds second = std::chrono::seconds(1);
  // What people call the time; tests set it. From any thread.
  std::function<WallNs()> wall = WallNow;
  // Where the figures of self-checks are kept (StateFolder()); empty: they end with the kiosk.
  std::filesystem::path state = {};
  // After each step of the machine; may be empty.
  std::function<void(const VisitState& state, const VisitEvent& event)> after_step = {};
  std::function<void(db::ForgetStep)> after_forget_step = {};  // WorkerOptions

  // kUsage for a plan that is no visitor's, and what [kiosk] may not say.
  [[nodiscard]] Status Validate() const;
};

// [kiosk] as the machine has it. `station`: with a valid plan. Fails as KioskOptions::Validate.
[[nodiscard]] Result<VisitRules> RulesOf(const StationOptions& station);

// Of all visits since the kiosk began.
struct KioskReport {
  int64_t begun = 0;  // visitors who pressed START
  int64_t captures = 0;
  int64_t tickets = 0, discarded = 0;   // visits that were kept, that were forgotten
  std::array<int64_t, kWords> ended{};  // by why, of those that left nothing else
  bool owed = false;                    // a visit could not be forgotten
};

// Until an operator's stop (StopToken, the front's Shutdown): then no capture runs, all lights are off, and what was to
// be forgotten is gone; a search for what might be left of it that is not finished is made after the next start.
// kFailed where that could not be. `station` was opened with `stop`. The program is the kiosk's: what its threads
// allocate lies in one arena from then on (mallopt).
[[nodiscard]] Result<KioskReport> RunKiosk(CaptureStation& station, const KioskOptions& options, KioskFront& front,
                                           StopToken& stop, Logger& logger);

}  // namespace stratalux::rig
