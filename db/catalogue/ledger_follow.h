// SPDX-License-Identifier: Apache-2.0
// What the ledger says, in the rows of the index: withdrawals in consents, certificates in deletions, forgotten
// visitors in none. The ledger is written first; an index that was cut off before its rows were written, lost or
// rebuilt learns them here. Internal to db/.
#pragma once

#include <filesystem>
#include <vector>

#include "db/catalogue/session_index.h"
#include "db/ledger/ledger.h"

namespace stratalux::db {

// Reads what was appended since the last time. kNewerSchema for a chain of a later version.
Status FollowLedger(SessionIndex& index, const std::filesystem::path& store);
// False where something was appended since. Reads no more than it must to know.
[[nodiscard]] Result<bool> FollowsLedger(SessionIndex& index, const std::filesystem::path& store);

// All withdrawals of the ledger once more, for sessions that came after their entry was read. The rows that this
// changed.
[[nodiscard]] Result<int64_t> FollowWithdrawals(SessionIndex& index, const std::filesystem::path& store);

// Visitors of whom nothing is here but consents, all of them named by notes of forgotten visitors. Whether there was
// any. One transaction of the caller's.
[[nodiscard]] Result<bool> RemoveForgottenVisitors(SessionIndex& index, const std::vector<LedgerEntry>& entries);

// When those consents were given that hold here though the ledger names them as withdrawn: until it is followed, and
// where several visitors gave theirs at the very moment, so that nobody can tell whose is meant.
[[nodiscard]] Result<std::vector<WallNs>> HoldingThoughWithdrawn(SessionIndex& index, const Ledger& ledger);

// The tombstones of deletions/ into the ledger, each of the moment that its row in the index has.
Status TakeOverTombstones(SessionIndex& index, const std::filesystem::path& store);

// The rows that TakeOverTombstones() and FollowLedger() would leave of deletions/, into `expected`: of those sessions
// that `index` has a row of, each of that row's moment. For who may write neither store nor index.
Status NoteTombstones(SessionIndex& expected, SessionIndex& index, const std::filesystem::path& store);
// False until the first opening for writing of an older store has told the ledger what the index alone knows.
[[nodiscard]] Result<bool> IsLedgerUp(SessionIndex& index);

// What the first opening for writing of an older store does, and every later one finds done: the store id, the
// tombstones of deletions/, withdrawals that stand in the index alone; then FollowLedger().
Status BringLedgerUp(SessionIndex& index, const std::filesystem::path& store);

}  // namespace stratalux::db
