// SPDX-License-Identifier: Apache-2.0
// The index of a store that is being restored: the backup's own where it is whole, else built from the folders; and
// what neither a backup's index nor a restored one may hold. Internal to db/transfer.
#pragma once

#include <filesystem>
#include <string>

#include "db/catalogue/session_index.h"
#include "db/ledger/ledger.h"
#include "db/transfer/backup.h"

namespace stratalux::db {

// As a forgetting leaves it: no row of sessions that the ledger forgets, no pseudonym of a visitor without another one.
// In a transaction of the caller's. True where there was any: what was deleted lies in the file until VACUUM.
[[nodiscard]] Result<bool> ForgetRows(SessionIndex& index, const Ledger& ledger);

// `work`/index.sqlite, a copy, brought to this schema and without the rows of sessions whose folder is not in `store`;
// of those that the store's ledger forgets, nothing of their visitors stays either. Folders that it does not list
// (sessions whose last good copy the backup kept) are listed by their files, under their old number where that is free.
// Not ok(): it is no index to use. `from` becomes their origin.
Status PrepareIndex(const std::filesystem::path& store, const std::filesystem::path& work, const std::string& from,
                    RestoreReport& report);
// From the folders; `why` is noted.
Status RebuildIndex(const std::filesystem::path& store, const Status& why, Logger& logger, RestoreReport& report);

}  // namespace stratalux::db
