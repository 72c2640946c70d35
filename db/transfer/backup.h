// SPDX-License-Identifier: Apache-2.0
// A copy of a store that is consistent while sessions are being written, and the way back.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::db {

// How many of the copies that an earlier backup made are reread: an eighth, those whose last check is the longest ago,
// so that eight backups reread every copy; or all.
enum class ScrubShare { kInTurn, kAll };

struct BackupOptions {
  std::filesystem::path to;    // a new folder, or that of an earlier backup of the same store
  std::filesystem::path keys;  // a copy of keys.sqlite goes to this file; empty: nowhere
  ScrubShare scrub = ScrubShare::kInTurn;
};

struct BackupReport {
  int64_t sessions = 0;  // that are in the backup as the store has them
  int64_t files_copied = 0, bytes_copied = 0;
  int64_t files_kept = 0;             // unchanged since the earlier backup
  int64_t files_continued = 0;        // copied by a run that was interrupted
  int64_t files_removed = 0;          // of sessions forgotten since
  int64_t files_reread = 0;           // copies of earlier backups
  std::vector<std::string> mended;    // copies that had rotted, made again from the store
  std::vector<std::string> left_out;  // sessions still being written
  std::vector<std::string> problems;  // sessions that are damaged or gone, and what the backup has of them
};

// The index as one transaction sees it (VACUUM INTO), every file of the finished sessions it lists, the ledger; last
// backup.json with size and hash of each. What is new or changed is verified frame by frame before it is copied: a
// damaged session is a problem of its own, its last good copy stays, the others are copied. An unchanged file (size and
// time) is not copied again. Keys are never in it: with them a forgotten session would come back. A session
// that changes while it is copied is copied again, once. kFailed where the backup cannot be written, or a chain of the
// ledger not be read: the one before stays valid, and the next run goes on.
[[nodiscard]] Result<BackupReport> Backup(const std::filesystem::path& store, const BackupOptions& options,
                                          Logger& logger);

enum class RestoreInto { kNewStore, kMerge };

struct RestoreOptions {
  RestoreInto into = RestoreInto::kNewStore;
  // kNewStore demands it: the newest ledger there is, so that nobody returns who was forgotten after the backup. A
  // store, another backup, or a folder of chains; `kNoLedger` where there is none any more, which is logged.
  std::string ledger;
};
inline constexpr const char* kNoLedger = "none";

struct RestoreReport {
  int64_t sessions = 0;
  int64_t files = 0, bytes = 0;
  int64_t forgotten = 0;    // sessions that the ledgers of either side keep away
  int64_t present = 0;      // with kMerge: sessions that the store has already
  int64_t withdrawals = 0;  // consents that the ledgers say were withdrawn
  std::vector<std::string> notes;
  std::vector<std::string> problems;  // sessions that were not restored, and why
};

// Every file against its hash in backup.json before it becomes visible; a session that fails is a problem of its own,
// and its copy here is wiped. kNewStore: `store` must be empty or missing (kUsage); numbers, access log and jobs are
// those of the backup, from whose index the rows of other sessions go; an index that is damaged is built again from the
// folders. kMerge: sessions that the store does not have come in behind those it has. The ledgers of the backup and of
// `options.ledger` are taken over: what they forget stays away, what they withdraw is withdrawn. An interrupted restore
// is continued: kBusy while a program has the index open that it left.
[[nodiscard]] Result<RestoreReport> Restore(const std::filesystem::path& from, const std::filesystem::path& store,
                                            const RestoreOptions& options, Logger& logger);

}  // namespace stratalux::db
