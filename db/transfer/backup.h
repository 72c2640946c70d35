// SPDX-License-Identifier: Apache-2.0
// A copy of a store that is consistent while sessions are being written, and the way back.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::db {

struct BackupOptions {
  std::filesystem::path to;    // a new folder, or that of an earlier backup of the same store
  std::filesystem::path keys;  // a copy of keys.sqlite goes to this file; empty: nowhere
};

struct BackupReport {
  int64_t sessions = 0;
  int64_t files_copied = 0, bytes_copied = 0;
  int64_t files_kept = 0;             // unchanged since the earlier backup
  int64_t files_removed = 0;          // of sessions forgotten since
  std::vector<std::string> left_out;  // sessions still being written
};

// The index as one transaction sees it (VACUUM INTO), every file of the finished sessions it lists, tombstones; last
// backup.json with size and hash of each. Segments are verified frame by frame before they are copied: a damaged one is
// kIntegrity and does not replace a good copy. An unchanged file (size and time) is not copied again. Keys are never in
// it: with them a forgotten session would come back. An interrupted backup is continued by the next.
[[nodiscard]] Result<BackupReport> Backup(const std::filesystem::path& store, const BackupOptions& options,
                                          Logger& logger);

enum class RestoreInto { kNewStore, kMerge };

struct RestoreReport {
  int64_t sessions = 0;
  int64_t files = 0, bytes = 0;
  int64_t forgotten = 0;  // sessions that tombstones of the backup or of the store keep away
  int64_t present = 0;    // with kMerge: sessions that the store has already
};

// Every file against its hash in backup.json before it becomes visible. kNewStore: `store` must be empty or missing
// (kUsage); numbers, access log and jobs are those of the backup. kMerge: sessions that the store does not have come in
// behind those it has. Tombstones of both sides hold, and the backup's are copied. An interrupted one is continued.
[[nodiscard]] Result<RestoreReport> Restore(const std::filesystem::path& from, const std::filesystem::path& store,
                                            RestoreInto into, Logger& logger);

}  // namespace stratalux::db
