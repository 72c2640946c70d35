// SPDX-License-Identifier: Apache-2.0
// Waiting for a lock that another program holds.
#pragma once

#include <chrono>
#include <functional>

#include "shared/base/result.h"

namespace stratalux::db {

// Calls `attempt` again while it says kBusy, until `patience` has passed: after pauses that grow up to a second, each
// with a share of chance, so that those who wait do not meet again. The last answer comes back. `attempt` must leave
// nothing behind when it says kBusy.
Status RetryWhileBusy(std::chrono::milliseconds patience, const std::function<Status()>& attempt);

}  // namespace stratalux::db
