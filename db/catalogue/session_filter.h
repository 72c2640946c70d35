// SPDX-License-Identifier: Apache-2.0
// Which sessions `ls` lists, and in what order: a WHERE and an ORDER BY, so that the index does the work.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "db/catalogue/read_only_index.h"
#include "shared/capture/session.h"

namespace stratalux::db {

// A bound on a figure of the newest fit of a session; a session without that figure does not pass.
struct FitBound {
  enum class Side { kAtMost, kAtLeast };
  std::string metric;  // as in the `metrics` table, or a short name (MetricName)
  Side side = Side::kAtMost;
  double value = 0.0;
};

enum class Fitted { kAny, kYes, kNo };
enum class SortKey { kNumber, kStarted, kFrames, kBytes, kFits, kNrmse, kCalibrationAge };
enum class SortOrder { kAscending, kDescending };

// Everything that is given must hold.
struct SessionFilter {
  std::optional<WallNs> since;  // started at or after
  std::optional<WallNs> until;  // started before
  std::vector<SessionStatus> statuses;
  std::vector<SessionKind> kinds;
  std::vector<std::string> rigs;
  std::vector<std::string> visitors;
  std::vector<std::string> visits;
  std::optional<std::string> calibration;  // prefix of its id; empty: sessions without one
  Fitted fitted = Fitted::kAny;
  std::vector<FitBound> bounds;
  SortKey sort = SortKey::kNumber;
  SortOrder order = SortOrder::kDescending;
  std::optional<int64_t> limit;
};

// nrmse, ssim, psnr_db (held-out stripe frames, tied model), white_nrmse, divergence, depth_rms_mm -> the full name of
// the figure; any other name is returned as it is.
[[nodiscard]] std::string MetricName(const std::string& name);

struct SessionQuery {
  std::string sql;
  QueryParameters parameters;
};
[[nodiscard]] SessionQuery QueryOf(const SessionFilter& filter);

// Columns: session, started, kind, rig, visitor, status, frames, bytes, fits, nrmse, calibration_age_days and, as
// details, reasons, simulated, retention, consent, calibration, finished, newest_fit, visit, attempt. The age is that
// at the session's start; consent as in the view session_overview.
Result<ResultTable> ListSessions(ReadOnlyIndex& index, const SessionFilter& filter);

}  // namespace stratalux::db
