// SPDX-License-Identifier: Apache-2.0
// Finished sessions of another store, over rsync and ssh. The other side's SQLite is never opened: its manifests say
// what there is.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::db {

enum class PullMode { kCopy, kDryRun };

struct PullReport {
  std::vector<std::string> sessions;  // pulled, or to be pulled (kDryRun), in the order of the source
  int64_t frames = 0;                 // of those that were pulled
  int64_t present = 0;                // here already
  int64_t unfinished = 0;             // recording or failed there: left there
  int64_t forgotten = 0;              // kept away by a tombstone of either side
  std::vector<std::string> problems;  // sessions that arrived damaged, or that only the source has forgotten
};

// `from`: user@host:/path/of/the/store or a local path. Each session is copied to STORE/incoming/<id> (an interrupted
// copy goes on from there), verified frame by frame, the other files against rsync's checksums, and only then moved
// into place and listed. Sessions that are here are left alone. kNotFound where rsync is missing, with the package's
// name.
[[nodiscard]] Result<PullReport> Pull(const std::filesystem::path& store, const std::string& from, PullMode mode,
                                      Logger& logger);

}  // namespace stratalux::db
