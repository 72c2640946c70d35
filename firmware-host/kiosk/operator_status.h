// SPDX-License-Identifier: Apache-2.0
// What the operator's screen is told of, beside the machine's state: GET /operator/status (docs/kiosk-page.md).
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/kiosk/batch_facts.h"
#include "firmware-host/kiosk/day_book.h"
#include "firmware-host/kiosk/host_facts.h"
#include "firmware-host/kiosk/selfcheck_trend.h"
#include "firmware-host/kiosk/store_facts.h"

namespace stratalux::rig {

struct StoreStatus {
  std::vector<RecentSession> sessions;
  std::optional<int> calibration_age_days;
  std::optional<int64_t> disk_free_bytes;
  std::optional<FitFacts> fits;
};

struct OperatorStatus {
  Phase screen = Phase::kClosed;
  std::optional<double> frames_per_second;
  int viewers = 0;
  std::vector<Temperature> temperatures;
  DayCounts today;
  std::vector<DayCounts> other_days;
  std::deque<KioskFault> faults;
  StoreStatus store;
  SelfcheckTrend selfchecks;
  TimerFacts batch_timer;
  std::vector<std::string> notes;  // what could not be kept, or read, as the log says it
};

[[nodiscard]] std::string ToJson(const OperatorStatus& status);

}  // namespace stratalux::rig
