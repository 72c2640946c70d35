// SPDX-License-Identifier: Apache-2.0
// STORE/deletions of stores before the ledger (schema 4): <id>.json, the certificate of a forgotten session, and
// <id>.forgetting, the intent of a forgetting that had begun. Read wherever they lie; taken over into the ledger by the
// first opening that may write. Internal to db/.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "db/ledger/ledger.h"

namespace stratalux::db {

struct OldTombstone {
  LedgerEntry entry;
  std::filesystem::path file;
};
// Certificates by session id, then intents. A damaged one still keeps its session away: its name tells which.
// kFailed where the folder is there and cannot be listed.
[[nodiscard]] Result<std::vector<OldTombstone>> ReadOldTombstones(const std::filesystem::path& store);

// When a session was gone by its row in the index, which the program of then wrote a little after the certificate.
using TombstoneMoments = std::map<std::string, WallNs>;

// Entries first, of the row's moment where there is one, then the files go: a certificate into its entry, an intent
// into STORE/ledger. Broken off anywhere, the next call goes on. kOk where there is no such folder.
Status TakeOverOldTombstones(const std::filesystem::path& store, const TombstoneMoments& moments = {});

}  // namespace stratalux::db
