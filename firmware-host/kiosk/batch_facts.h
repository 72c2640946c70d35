// SPDX-License-Identifier: Apache-2.0
// What this machine knows of the night in which visitors are fitted (docs/batch.md), which may be another machine's.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::rig {

// A timer of systemd.
struct TimerFacts {
  enum class Here : uint8_t {
    kUnknown,  // nobody says: no systemd, or it does not answer
    kAbsent,   // there is none of that name
    kOff,
    kOn
  };
  Here here = Here::kUnknown;
  std::optional<WallNs> next, last;  // of kOn; `last`: when it last went off, since it is there
  friend bool operator==(const TimerFacts&, const TimerFacts&) = default;
};
[[nodiscard]] const char* ToString(TimerFacts::Here here);  // "unknown", "absent", "off", "on"

inline constexpr const char* kBatchTimer = "stratalux-batch.timer";

// Of what `systemctl show` printed of the unit: Id, LoadState, ActiveState, NextElapseUSecRealtime, LastTriggerUSec, a
// line each, times in UTC, as people have them or as "@seconds".
[[nodiscard]] TimerFacts TimerOf(const std::string& shown, const std::string& unit);
// Asks systemctl, three seconds at most. `systemctl`: the program, looked up in PATH.
[[nodiscard]] TimerFacts AskTimer(const std::string& systemctl, const std::string& unit);

// Of the store on this machine.
struct FitFacts {
  int64_t without_fit = 0;  // visitors, complete or degraded, of whom it holds no fit
  bool has_jobs = false;    // a batch has ever queued anything here
  int64_t waiting = 0;      // queued or running
  // Of the last 24 hours.
  int64_t fitted = 0, failed = 0;  // failed: set aside, too
  friend bool operator==(const FitFacts&, const FitFacts&) = default;
};
// Never migrates; kNotFound where there is no store yet.
[[nodiscard]] Result<FitFacts> FitsOf(const std::filesystem::path& store, WallNs now);

}  // namespace stratalux::rig
