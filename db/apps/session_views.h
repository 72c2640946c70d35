// SPDX-License-Identifier: Apache-2.0
// What `stratalux-db show|frames|verify` print: text for people, JSON for programs.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "db/care/verify.h"
#include "db/catalogue/session_store.h"

namespace stratalux::db {

struct PhaseCount {
  std::string phase;
  int64_t projector = -1;  // -1: lit by all of them
  int64_t frames = 0;
};

struct SessionDetails {
  SessionRow row;
  std::string consent_json;        // as in the view session_overview; empty: none
  std::string due, due_reason;     // when `purge` takes it, ISO 8601, and why; empty: it stays
  std::vector<PhaseCount> phases;  // in the order of the plan
  std::vector<FitRow> fits;
};
// From the index alone: no segment is opened (`verify` does that).
[[nodiscard]] Result<SessionDetails> LoadDetails(const SessionStore& store, const std::string& selector);
[[nodiscard]] std::string DetailsAsText(const SessionDetails& details);
// {"session", "started", "kind", "rig", "visitor", "status", "reasons", "simulated", "frames", "bytes", "visit",
// "attempt", "findings" and "faults" as in the manifest, "consent", "retention", "due", "seed", "program_version",
// "plan", "calibration", "phases", "fits" as objects}.
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
