// SPDX-License-Identifier: Apache-2.0
// The figures of `stratalux-db stats`, gathered from named queries and laid out in time.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "db/catalogue/read_only_index.h"
#include "shared/units/time.h"

namespace stratalux::db {

struct SeriesPoint {
  std::string label;            // "2026-11-21", the first day of the bin; or a reason
  std::optional<double> value;  // none: nothing was measured
};

struct Series {
  std::string title;
  enum class Unit { kCount, kBytes, kNumber } unit = Unit::kCount;
  std::vector<SeriesPoint> points;
};

// Days without a session are there, too. At most kMostBins bins: beyond as many days a bin is several of them.
struct Statistics {
  WallNs since, until;
  int days_per_bin = 1;
  int64_t sessions = 0, complete = 0, frames = 0, bytes = 0;  // within the span
  Series sessions_per_bin;
  Series not_complete_per_bin;  // degraded or failed
  Series disk;                  // payloads of all sessions until then, also of those before `since`
  Series nrmse;                 // of fits made in the bin, mean; FitOverview's figure
  Series failures;              // the ten commonest reasons, sessions
};
inline constexpr int kMostBins = 60;

// The days of [since, until], UTC. kUsage: until lies before since.
Result<Statistics> LoadStatistics(ReadOnlyIndex& index, WallNs since, WallNs until);

// {"since", "until", "days_per_bin", totals, "sessions_per_bin": [{"from", "value"}], ...}.
[[nodiscard]] std::string StatisticsAsJson(const Statistics& statistics);

}  // namespace stratalux::db
