// SPDX-License-Identifier: Apache-2.0
// What the ledger says, in the rows of the index: withdrawals in consents, certificates in deletions. The ledger is
// written first; an index that was cut off before its rows were written, lost or rebuilt learns them here. Internal to
// db/.
#pragma once

#include <filesystem>

#include "db/catalogue/session_index.h"

namespace stratalux::db {

// Reads what was appended since the last time. kNewerSchema for a chain of a later version.
Status FollowLedger(SessionIndex& index, const std::filesystem::path& store);
// False where something was appended since. Reads no more than it must to know.
[[nodiscard]] Result<bool> FollowsLedger(SessionIndex& index, const std::filesystem::path& store);

// The tombstones of deletions/ into the ledger, each of the moment that its row in the index has.
Status TakeOverTombstones(SessionIndex& index, const std::filesystem::path& store);

// What the first opening for writing of an older store does, and every later one finds done: the store id, the
// tombstones of deletions/, withdrawals that stand in the index alone; then FollowLedger().
Status BringLedgerUp(SessionIndex& index, const std::filesystem::path& store);

}  // namespace stratalux::db
