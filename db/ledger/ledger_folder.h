// SPDX-License-Identifier: Apache-2.0
// STORE/ledger as files: its lock, which chains it holds, the end of a chain. Internal to db/ledger.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/ledger/ledger_line.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {

[[nodiscard]] std::filesystem::path LedgerFolder(const std::filesystem::path& store);

// LEDGER/lock, held while this lives; the folder is made. Waits ten seconds for others (an append takes milliseconds),
// then kBusy.
[[nodiscard]] Result<UniqueFd> LockLedger(const std::filesystem::path& store);

// A chain's file: <store id>.jsonl, or <store id>.fork-<16 digits>.jsonl.
struct ChainFile {
  std::filesystem::path path;
  std::string store_id;
};
// By name; none where there is no such folder. Other names are none of ours. kFailed where it cannot be listed.
[[nodiscard]] Result<std::vector<ChainFile>> ListChains(const std::filesystem::path& folder);
// Ten years of a rig with a hundred visitors a day. Nobody may shorten a chain, so that what is longer stays unread.
inline constexpr int64_t kMostChainBytes = int64_t{1} << 30;
// kIntegrity where it is no regular file: no chain, then. kFailed, with what to do, where it is one and cannot be read.
[[nodiscard]] Result<std::string> ReadChain(const std::filesystem::path& file);

// What LEDGER/store.id says. kNotFound where there is none, kIntegrity for other bytes, kFailed where it is there and
// cannot be read.
[[nodiscard]] Result<std::string> StoreIdIn(const std::filesystem::path& folder);
// Under the lock: the id in LEDGER/store.id, made where there is none. A damaged one is replaced by a fresh id: the
// chain it named stays, and binds. kFailed, with the old one kept, where it cannot be read.
[[nodiscard]] Result<std::string> OwnStoreId(const std::filesystem::path& store);

// Under the lock: all of them with one write and one sync, or none.
Status AppendLocked(const std::filesystem::path& store, const std::vector<LedgerEntry>& entries);

}  // namespace stratalux::db
