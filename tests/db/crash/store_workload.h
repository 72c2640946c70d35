// SPDX-License-Identifier: Apache-2.0
// A night at a kiosk in small, and what the store has promised at each moment of it.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"

namespace stratalux::db::crash {

struct SessionPromise {
  std::string id;
  int64_t acknowledged = 0;
  std::optional<SessionStatus> ended;  // once Finish() or a recovery returned
  std::optional<std::string> fit;      // registered
};

// What no power cut may take back.
struct Promise {
  bool created = false;
  std::vector<SessionPromise> sessions;
};

struct WorkloadReport {
  std::vector<Promise> promises;   // Mark(i) in the log: promises[i] was made
  std::vector<Status> failures;    // of calls the disk refused, in order
  std::vector<std::string> notes;  // what openings said
};

// Runs below `folder` (which exists and is empty), recording marks: creates the store; a session over several segments
// and groups with a truth map, finished, with a fit; one that its writer abandons, with a checkpoint in its midst; an
// opening that recovers it; one finished as degraded. Goes on after failures as far as the calls allow.
WorkloadReport RunWorkload(const std::filesystem::path& folder, Encryption encryption = Encryption::kNone);

// A frame of the workload. Its step tells its pixels.
Status AppendFrame(SessionWriter& writer, int step);
// True when the pixels are those that AppendFrame() stored under this step.
bool HasPixelsOf(const Image<uint16_t>& image, int step);

inline constexpr const char* kFitText = "position.exr of a fit";

}  // namespace stratalux::db::crash
