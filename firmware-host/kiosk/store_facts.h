// SPDX-License-Identifier: Apache-2.0
// What the operator's screen asks the store.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "db/privacy/disclosure.h"
#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::rig {

struct RecentSession {
  std::string id, kind, status;
  WallNs started;
  int64_t frames = 0;
  std::vector<std::string> reasons;  // why degraded or failed
};

// Newest first. Never migrates; kNotFound where there is no store yet.
[[nodiscard]] Result<std::vector<RecentSession>> RecentSessions(const std::filesystem::path& store, int most);

// A small grey JPEG of the session, in memory alone; who looks is entered in `log` before. kUsage where consent does
// not cover it; kNotFound where the session is forgotten, has no frame, or is encrypted and its key is not here.
[[nodiscard]] Result<std::string> SessionPicture(const std::filesystem::path& store, const std::string& id,
                                                 const std::string& peer, db::DisclosureLog& log);

// Of the newest calibration of this rig, whole days; nullopt where it has none or the store cannot say.
[[nodiscard]] std::optional<int> CalibrationAgeDays(const std::filesystem::path& store, const std::string& rig,
                                                    bool simulated, WallNs now);

}  // namespace stratalux::rig
