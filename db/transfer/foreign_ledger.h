// SPDX-License-Identifier: Apache-2.0
// What another store says was forgotten and withdrawn comes to bind this one.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/ledger/ledger.h"

namespace stratalux::db {

// Takes over the chains of `other` (a store, a backup, what was fetched of a source) and, of a store before the ledger,
// its certificates and begun forgettings as entries of our own chain. Returns what was new and what is damaged.
[[nodiscard]] Result<LedgerMerge> AdoptLedger(const std::filesystem::path& store, const std::filesystem::path& other);

// Withdraws in the index what the ledger says was withdrawn: the consents that the visitor of such a session had given
// until then. Returns the number of consents.
[[nodiscard]] Result<int64_t> ApplyWithdrawals(const std::filesystem::path& store);

// Sessions that the ledger forgets, and that the index lists or that have a folder.
[[nodiscard]] Result<std::vector<std::string>> ForgottenButHere(const std::filesystem::path& store);

}  // namespace stratalux::db
