// SPDX-License-Identifier: Apache-2.0
// Who took what out of the store: rows of access_log, which outlive the session they speak of. Logged is what gives
// pixels or what was made of them to somebody (extract, export, fit, decode, render, report), and keys that leave (key
// export, batch keys); lists and proofs are not.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::db {

struct AccessEntry {
  WallNs at;
  std::string who;     // operating-system user
  std::string action;  // "extract", "fit", ...
  std::string session;
  std::string detail;  // for exports the place (export_marker.h), else free text
};

// Called before the bytes leave, so that no copy goes unlogged (a fit, which leaves nothing, logs when it is done). kOk
// without a row where the store itself cannot be written (a read-only disk, another account's store): reading must not
// fail for it.
Status LogAccess(const std::filesystem::path& store, const std::string& action, const std::string& session_id,
                 const std::string& detail);
// Oldest first; of all sessions for an empty prefix of ids.
[[nodiscard]] Result<std::vector<AccessEntry>> ListAccess(const std::filesystem::path& store,
                                                          const std::string& session_prefix);
[[nodiscard]] std::string OperatingSystemUser();

}  // namespace stratalux::db
