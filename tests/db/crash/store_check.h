// SPDX-License-Identifier: Apache-2.0
// Whether a store kept its promises, told by opening it with the real code.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "tests/db/crash/store_workload.h"

namespace stratalux::db::crash {

struct CheckCounts {
  int64_t stores = 0, sessions = 0, frames = 0;
};

// Opens (which recovers), reads all, writes a new session, opens again. Empty: every promise is kept; else what is
// broken, for people.
std::vector<std::string> CheckStore(const std::filesystem::path& folder, const Promise& promise, CheckCounts& counts);

}  // namespace stratalux::db::crash
