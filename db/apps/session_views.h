// SPDX-License-Identifier: Apache-2.0
// What `stratalux-db ls|show|frames|verify` print: text for people, JSON for programs.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "db/session_store.h"
#include "db/verify.h"

namespace stratalux::db {

// A session with the number of its fits.
struct ListedSession {
  SessionRow row;
  int64_t fits = 0;
};
[[nodiscard]] Result<std::vector<ListedSession>> ListWithFits(const SessionStore& store);

// A table: id, when, kind, rig, visitor, status, frames, size, fits.
[[nodiscard]] std::string SessionsAsText(const std::vector<ListedSession>& sessions);
// [{"session", "started", "kind", "rig", "visitor", "status", "reasons", "simulated", "frames", "bytes", "fits"}].
[[nodiscard]] std::string SessionsAsJson(const std::vector<ListedSession>& sessions);

struct SessionDetails {
  SessionRow row;
  std::vector<FrameRow> frames;
  std::vector<FitRow> fits;
};
[[nodiscard]] Result<SessionDetails> LoadDetails(const SessionStore& store, const std::string& selector);
[[nodiscard]] std::string DetailsAsText(const SessionDetails& details);
// The object of SessionsAsJson plus "consent", "seed", "program_version", "plan", "calibration", "phases" and the fits
// as objects.
[[nodiscard]] std::string DetailsAsJson(const SessionDetails& details);

struct FrameFilter {
  std::optional<CapturePhase> phase;
  std::optional<int> projector;
};
[[nodiscard]] std::vector<FrameRow> Filter(std::vector<FrameRow> frames, const FrameFilter& filter);
[[nodiscard]] std::string FramesAsText(const std::vector<FrameRow>& frames);
// The whole proof row of each frame.
[[nodiscard]] std::string FramesAsJson(const std::vector<FrameRow>& frames);

using Verified = std::vector<std::pair<std::string, VerifyReport>>;  // session id, report
[[nodiscard]] std::string VerifiedAsText(const Verified& verified);
[[nodiscard]] std::string VerifiedAsJson(const Verified& verified);

}  // namespace stratalux::db
