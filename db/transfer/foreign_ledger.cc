// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/foreign_ledger.h"

#include "db/catalogue/ledger_follow.h"
#include "db/catalogue/session_index.h"

namespace stratalux::db {

namespace fs = std::filesystem;

Result<LedgerMerge> AdoptLedger(const fs::path& store, const fs::path& other) {
  SLX_ASSIGN_OR_RETURN(LedgerMerge merge, MergeLedger(store, other / "ledger"));
  SLX_ASSIGN_OR_RETURN(const Ledger theirs, Ledger::Read(other));
  SLX_ASSIGN_OR_RETURN(const Ledger ours, Ledger::Read(store));
  for (const auto& [id, certificate] : theirs.forgotten()) {
    const auto known = ours.forgotten().find(id);
    if (known != ours.forgotten().end() && (certificate.empty() || !known->second.empty())) continue;
    LedgerEntry entry;
    entry.kind = certificate.empty() ? LedgerKind::kForgetting : LedgerKind::kForgotten;
    entry.at = WallNow();
    entry.sessions = {id};
    entry.detail_json = certificate.empty() ? R"({"reason": "forget"})" : certificate;
    SLX_RETURN_IF_ERROR(AppendToLedger(store, entry));
    ++merge.entries;
  }
  return merge;
}

Result<int64_t> ApplyWithdrawals(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  return FollowWithdrawals(index, store);
}

Result<std::vector<std::string>> ForgottenButHere(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  std::vector<std::string> here;
  for (const auto& [id, certificate] : ledger.forgotten()) {
    const auto number = index.NumberOf(id);
    std::error_code error;
    if (number.ok() || fs::exists(store / "sessions" / id, error)) here.push_back(id);
    if (!number.ok() && number.status().code() != StatusCode::kNotFound) return number.status();
  }
  return here;
}

}  // namespace stratalux::db
