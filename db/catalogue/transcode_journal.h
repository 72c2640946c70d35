// SPDX-License-Identifier: Apache-2.0
// STORE/transcode.json: the session whose segments a transcode is replacing. It is there exactly while old and new ones
// may lie side by side in the session's folder; the index says which of them count. Internal to db/.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "db/catalogue/session_index.h"
#include "shared/base/result.h"

namespace stratalux::db {

struct TranscodeJournal {
  std::string session;
  int64_t first_new = 0;  // frames-NNNN.seg from this number on are new, those below are old
};

// Numbers of the frames-NNNN.seg in a session's folder, ascending.
Result<std::vector<int64_t>> SegmentNumbers(const std::filesystem::path& session_folder);

// Synced. `store` is the store's folder.
Status WriteTranscodeJournal(const std::filesystem::path& store, const TranscodeJournal& journal);
// nullopt when there is none; kIntegrity when it is damaged.
Result<std::optional<TranscodeJournal>> ReadTranscodeJournal(const std::filesystem::path& store);

// Makes the session's folder hold the segments that the index names and no others of the journal, and removes the
// journal: after the index's commit the new ones stay, before it the old ones. Under the store's write lock.
Status SettleTranscode(SessionIndex& index, const std::filesystem::path& store, const TranscodeJournal& journal);
// SettleTranscode for what a program that died has left; kOk when there is nothing, or when the program lives.
Status EndInterruptedTranscode(SessionIndex& index, const std::filesystem::path& store);

}  // namespace stratalux::db
