// SPDX-License-Identifier: Apache-2.0
// session.json of a session in a crate, and under which consent the session may leave the store. Internal to
// db/interchange.
#pragma once

#include <filesystem>
#include <string>

#include "db/catalogue/session_store.h"
#include "db/interchange/crate_export.h"

namespace stratalux::db {

// Whether this session may leave for this purpose today: its own consent was not withdrawn, and the newest consent of
// its visitor holds and covers the purpose. Sessions of other kinds show nobody and pass. kUsage names the session, why
// not, and what helps.
[[nodiscard]] Status MayLeave(const std::filesystem::path& store, const SessionInfo& info, CrateScope scope);

struct CrateSession {
  SessionInfo info;  // plan_json and calibration_json: see below
  int64_t frames = 0;
  bool has_plan = false, has_calibration = false;  // plan.json, calibration/calibration.json
};

[[nodiscard]] std::string CrateSessionText(const SessionInfo& info, int64_t frames, CrateScope scope);
// kIntegrity naming `file` for anything that no writer of ours makes, kNewerSchema for one of a later version.
[[nodiscard]] Result<CrateSession> ParseCrateSession(const std::string& text, const std::string& file);

// s000017-0badcafe and the like: letters, digits, '-' and '_', 1 to 64 of them, a letter or digit first.
[[nodiscard]] bool IsSessionId(const std::string& id);

}  // namespace stratalux::db
