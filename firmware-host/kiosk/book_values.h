// SPDX-License-Identifier: Apache-2.0
// What the kiosk's books on the disk have in common: what none of us wrote is refused as nlohmann's JSON refuses a
// wrong type, by nlohmann::json::exception, so that a reader catches one kind.
#pragma once

#include <cstdint>
#include <string>

#include "shared/units/time.h"

namespace stratalux::rig {

[[noreturn]] void Refuse(const std::string& what);

// Throws as Refuse does of a date after the year 2255, which is no clock's and has no nanoseconds.
[[nodiscard]] WallNs TimeOf(int64_t seconds_since_1970);

}  // namespace stratalux::rig
