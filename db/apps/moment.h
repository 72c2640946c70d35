// SPDX-License-Identifier: Apache-2.0
// Moments as people type them.
#pragma once

#include <string>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::db {

// "2026-11-21", "2026-11-21T04:06", "2026-11-21T04:06:11Z" (UTC, as everything is printed), or an age before `now`:
// "30m", "12h", "7d", "2w". kUsage for anything else, also for a day that is none (2026-02-30).
[[nodiscard]] Result<WallNs> ParseMoment(const std::string& text, WallNs now);

}  // namespace stratalux::db
