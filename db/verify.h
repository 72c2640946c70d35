// SPDX-License-Identifier: Apache-2.0
// Checks a session's segments against their hashes, the index and the plan.
#pragma once

#include <string>
#include <vector>

#include "db/session_store.h"

namespace stratalux::db {

struct VerifyReport {
  int64_t frames = 0;
  int64_t bytes = 0;
  std::vector<std::string> problems;  // damage: each names file and offset, or step
  std::vector<std::string> notes;     // not damage: unsealed segment of a failed session, steps without a good frame
};

// Reads every byte. Never fails on damage: it reports it.
[[nodiscard]] Result<VerifyReport> VerifySession(const SessionStore& store, const SessionRow& session);

}  // namespace stratalux::db
