// SPDX-License-Identifier: Apache-2.0
// How far a night is, out of its log: for `batch status`, `batch watch` and the morning report.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "fitter/batch/night_log.h"

namespace stratalux::fit {

// A visitor's last word: the event that ended it, or its start.
struct NightVisit {
  std::string session = {}, fit = {};
  NightEventKind kind = NightEventKind::kStarted;
  int attempts = 0;  // the last one, of all nights: the queue counts on, and names worker logs by it
  WallNs at = {};
  double seconds = 0.0, cpu_seconds = 0.0;  // of the attempt that ended it
  int64_t peak_bytes = 0;                   // the most of its attempts
  std::string reason = {};
};

struct NightStatus {
  WallNs began = {};
  std::optional<WallNs> ended = {};
  std::string end_reason = {};
  bool ended_by_error = false;
  int64_t chosen = 0;
  std::vector<NightVisit> visits;  // in the order of their first start
  std::vector<NightEvent> left_out;
  [[nodiscard]] int Count(NightEventKind kind) const;
  // Visitors who are done with, one way or another.
  [[nodiscard]] int Over() const;
};

[[nodiscard]] NightStatus StatusOf(const std::vector<NightEvent>& events);

// kDegraded, saying why, where the newest night of the store did not begin at `since` or later, has not ended, was
// ended by an error, left somebody who could not be fitted, or cannot be read.
[[nodiscard]] Status CheckNewestNight(const std::filesystem::path& store, WallNs since);

}  // namespace stratalux::fit
