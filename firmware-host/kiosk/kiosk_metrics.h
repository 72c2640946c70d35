// SPDX-License-Identifier: Apache-2.0
// What the kiosk counts, from what it shows: for the operator's screen, by the day, and for Prometheus, since the
// program began.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/kiosk/day_book.h"
#include "firmware-host/kiosk/host_facts.h"
#include "firmware-host/kiosk/selfcheck_trend.h"
#include "firmware-host/kiosk/visit_actions.h"
#include "firmware-host/kiosk/words.h"
#include "shared/units/time.h"

namespace stratalux::rig {

struct KioskFigures {
  Phase screen = Phase::kClosed;
  int64_t visits_begun = 0;
  std::map<std::string, int64_t> visits;  // by how they ended: "kept", "withdrawn", else the word ("refused", "left")
  int64_t retakes = 0, frames = 0;
  std::map<std::string, int64_t> faults;    // told to the operator, by word
  std::optional<double> frames_per_second;  // of the last capture
};

// Used by one thread.
class KioskMetrics {
 public:
  using Clock = std::function<std::chrono::steady_clock::time_point()>;
  // `days`: as an earlier program left them.
  explicit KioskMetrics(DayBook days = {}, Clock now = std::chrono::steady_clock::now);

  void Shown(const action::Show& show, WallNs at);
  // The visitor's ticket was given out: what was captured stays, unless they withdraw on the spot.
  void Kept() { kept_ = true; }
  void Told(Word word, WallNs at);
  [[nodiscard]] const KioskFigures& figures() const { return figures_; }
  [[nodiscard]] const DayBook& days() const { return days_; }

 private:
  void BeginCapture(WallNs at);
  void EndVisit(Word word, WallNs at);

  Clock now_;
  DayBook days_;
  KioskFigures figures_;
  bool in_visit_ = false, kept_ = false;
  int captures_ = 0, done_ = 0;
  std::chrono::steady_clock::time_point capture_began_;
};

struct KioskGauges {
  int viewers = 0;
  std::optional<int64_t> disk_free_bytes;
  std::vector<Temperature> temperatures;
};

// Prometheus text exposition format 0.0.4.
[[nodiscard]] std::string PrometheusText(const KioskFigures& figures, const KioskGauges& gauges,
                                         const SelfcheckTrend& selfchecks = {});

}  // namespace stratalux::rig
