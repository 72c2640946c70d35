// SPDX-License-Identifier: Apache-2.0
// Times of day, "07:00", by this machine's clock and time zone.
#pragma once

#include <chrono>
#include <ctime>
#include <string>

#include "shared/base/result.h"

namespace stratalux::fit {

// From `now` until the next time that the clock says so: more than 0, and a day at most (25 hours where summer ends).
// kUsage, naming the `option` that was given so.
[[nodiscard]] Result<std::chrono::seconds> TimeUntil(const std::string& text, std::time_t now,
                                                     const char* option = "--until");
// From the last time that the clock said so until `now`: 0 where it does now.
[[nodiscard]] Result<std::chrono::seconds> TimeSince(const std::string& text, std::time_t now, const char* option);
// Whether `now` lies in the span from the one to the other, the first included; it may pass midnight. kUsage where both
// are one.
[[nodiscard]] Result<bool> IsBetween(const std::string& from, const std::string& until, std::time_t now);

}  // namespace stratalux::fit
