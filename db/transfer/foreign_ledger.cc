// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/foreign_ledger.h"

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
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  if (ledger.withdrawn().empty()) return int64_t{0};
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(index.connection()));
  const std::string which =
      " WHERE visitor = (SELECT visitor FROM sessions WHERE id = ?1) AND visitor <> ''"
      " AND withdrawn_wall_ns IS NULL AND given_wall_ns <= ?2";
  SLX_ASSIGN_OR_RETURN(auto count, index.connection().Prepare("SELECT count(*) FROM consents" + which));
  SLX_ASSIGN_OR_RETURN(auto update, index.connection().Prepare("UPDATE consents SET withdrawn_wall_ns = ?2" + which));
  int64_t withdrawn = 0;
  for (const auto& [id, at] : ledger.withdrawn()) {
    SLX_RETURN_IF_ERROR(count.Bind(1, id).Bind(2, at.ns).Step().status());
    const int64_t fresh = count.Integer(0);
    count.Reset();
    if (fresh == 0) continue;
    withdrawn += fresh;
    SLX_RETURN_IF_ERROR(update.Bind(1, id).Bind(2, at.ns).Run());
  }
  SLX_RETURN_IF_ERROR(transaction.Commit());
  return withdrawn;
}

Result<std::vector<std::string>> ForgottenButHere(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  std::vector<std::string> here;
  for (const auto& [id, certificate] : ledger.forgotten()) {
    const auto number = index.NumberOf(id);
    if (number.ok()) here.push_back(id);
    if (!number.ok() && number.status().code() != StatusCode::kNotFound) return number.status();
  }
  return here;
}

}  // namespace stratalux::db
