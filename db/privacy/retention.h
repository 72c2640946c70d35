// SPDX-License-Identifier: Apache-2.0
// Which visitors' sessions are due: past the days of their class, or made under a consent that was withdrawn. Sessions
// of other kinds show nobody and are never due.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "shared/capture/session.h"

namespace stratalux::db {

struct DueSession {
  std::string id;
  std::string reason;  // "standard: 400 days old, kept for 365", "consent withdrawn on 2026-11-21T11:08:06Z"
  // By the index.
  int64_t frames = 0, fits = 0;
  int64_t bytes = 0;  // of the frames' payloads
  bool encrypted = false;
};

// Oldest first. The age counts from the end of the session (its start, when it never ended) to `now`; a session of the
// future, as a clock that was wrong makes them, is not due. Whether a consent was withdrawn is asked of the consent the
// session was made under, and of the visitor's newest where that is not known here; what the ledger alone says counts,
// too.
[[nodiscard]] Result<std::vector<DueSession>> DueSessions(const std::filesystem::path& store, const RetentionDays& days,
                                                          WallNs now);

struct IncomingDue {
  std::vector<DueSession> sessions;
  // Of each manifest of a later program, by which nothing is due here, what is wrong with it.
  std::vector<std::string> newer;
};

// The same of sessions that incoming/ alone knows, by their manifests there: what a broken-off transfer left of a
// source that may never come back, and manifests that a pull kept of sessions it never took. What no manifest tells of
// counts as of the shortest class, from its newest file on. By id; wipe them as the next transfer would (WipeIncoming),
// with none at work (IncomingLock).
[[nodiscard]] Result<IncomingDue> DueIncoming(const std::filesystem::path& store, const RetentionDays& days,
                                              WallNs now);

}  // namespace stratalux::db
