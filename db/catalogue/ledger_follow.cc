// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/ledger_follow.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "db/catalogue/forgotten_rows.h"
#include "db/ledger/ledger.h"
#include "db/ledger/old_tombstones.h"
#include "shared/base/json_nesting.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

Result<std::map<std::string, int64_t>> ReadHeads(Connection& connection) {
  std::map<std::string, int64_t> heads;
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT chain, bytes FROM ledger_heads WHERE chain <> ''"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return heads;
    heads[select.Text(0)] = select.Integer(1);
  }
}

Status WriteHeads(Connection& connection, const std::map<std::string, int64_t>& heads) {
  SLX_RETURN_IF_ERROR(connection.Execute("DELETE FROM ledger_heads WHERE chain <> ''"));
  SLX_ASSIGN_OR_RETURN(auto insert, connection.Prepare("INSERT INTO ledger_heads (chain, bytes) VALUES (?1, ?2)"));
  for (const auto& [chain, bytes] : heads) SLX_RETURN_IF_ERROR(insert.Bind(1, chain).Bind(2, bytes).Run());
  return Status::Ok();
}

// Withdraws all that the visitor of a session had given by then, and what the session was made under, should a clock
// have gone back in between.
class Withdrawing {
 public:
  static Result<Withdrawing> Prepare(Connection& connection) {
    const std::string which =
        " WHERE withdrawn_wall_ns IS NULL AND visitor = (SELECT visitor FROM sessions WHERE id = ?1 AND visitor <> '')"
        " AND (given_wall_ns <= ?2 OR given_wall_ns = (SELECT CASE WHEN json_valid(consent_json) THEN"
        " json_extract(consent_json, '$.given_wall_ns') END FROM sessions WHERE id = ?1))";
    SLX_ASSIGN_OR_RETURN(auto count, connection.Prepare("SELECT count(*) FROM consents" + which));
    SLX_ASSIGN_OR_RETURN(auto update, connection.Prepare("UPDATE consents SET withdrawn_wall_ns = ?2" + which));
    return Withdrawing(std::move(count), std::move(update));
  }
  // The number of consents that held until now.
  Result<int64_t> Withdraw(const std::string& session, WallNs at) {
    SLX_RETURN_IF_ERROR(count_.Bind(1, session).Bind(2, at.ns).Step().status());
    const int64_t held = count_.Integer(0);
    count_.Reset();
    if (held > 0) SLX_RETURN_IF_ERROR(update_.Bind(1, session).Bind(2, at.ns).Run());
    return held;
  }

 private:
  Withdrawing(Statement count, Statement update) : count_(std::move(count)), update_(std::move(update)) {}
  Statement count_, update_;
};

// Consents of one moment.
struct GivenAt {
  std::vector<int64_t> holding;  // consents.number
  std::string visitor;
  bool of_several = false;  // visitors: it cannot be told whom a withdrawal means that names this moment
};

// By when they were given, to the nanosecond; of a consent of unknown moment (0) nothing is known by it.
Result<std::map<int64_t, GivenAt>> ConsentsByMoment(Connection& connection) {
  SLX_ASSIGN_OR_RETURN(auto select,
                       connection.Prepare("SELECT given_wall_ns, visitor, number, withdrawn_wall_ns IS NULL"
                                          " FROM consents WHERE given_wall_ns > 0 ORDER BY number"));
  std::map<int64_t, GivenAt> moments;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return moments;
    const auto [at, fresh] = moments.try_emplace(select.Integer(0));
    if (fresh) at->second.visitor = select.Text(1);
    at->second.of_several |= at->second.visitor != select.Text(1);
    if (select.Integer(3) != 0) at->second.holding.push_back(select.Integer(2));
  }
}

// What these entries withdraw, the earliest first: the number of consents that held until now.
Result<int64_t> Withdraw(Connection& connection, const std::vector<LedgerEntry>& of_all_kinds) {
  std::vector<LedgerEntry> entries;
  std::ranges::copy_if(of_all_kinds, std::back_inserter(entries),
                       [](const LedgerEntry& entry) { return entry.kind == LedgerKind::kWithdrawal; });
  if (entries.empty()) return 0;
  std::ranges::stable_sort(entries, {}, [](const LedgerEntry& entry) { return entry.at.ns; });
  SLX_ASSIGN_OR_RETURN(auto withdrawing, Withdrawing::Prepare(connection));
  int64_t withdrawn = 0;
  for (const LedgerEntry& entry : entries)
    for (const std::string& session : entry.sessions) {
      SLX_ASSIGN_OR_RETURN(const int64_t held, withdrawing.Withdraw(session, entry.at));
      withdrawn += held;
    }
  SLX_ASSIGN_OR_RETURN(auto moments, ConsentsByMoment(connection));
  SLX_ASSIGN_OR_RETURN(auto update, connection.Prepare("UPDATE consents SET withdrawn_wall_ns = ?2 WHERE number = ?1"));
  for (const LedgerEntry& entry : entries)
    for (const WallNs given : ConsentsWithdrawnBy(entry)) {
      const auto at = moments.find(given.ns);
      if (at == moments.end() || at->second.of_several) continue;
      for (const int64_t number : std::exchange(at->second.holding, {})) {
        SLX_RETURN_IF_ERROR(update.Bind(1, number).Bind(2, entry.at.ns).Run());
        ++withdrawn;
      }
    }
  return withdrawn;
}

// Visitors whose consents these entries name, all of them.
Result<std::vector<std::string>> VisitorsForgottenBy(Connection& connection, const std::vector<LedgerEntry>& entries) {
  std::set<int64_t> forgotten;
  for (const LedgerEntry& entry : entries)
    for (const WallNs given : ConsentsForgottenBy(entry)) forgotten.insert(given.ns);
  std::vector<std::string> visitors;
  if (forgotten.empty()) return visitors;
  SLX_ASSIGN_OR_RETURN(const auto moments, ConsentsByMoment(connection));
  SLX_ASSIGN_OR_RETURN(auto other, connection.Prepare("SELECT given_wall_ns FROM consents WHERE visitor = ?1 AND"
                                                      " given_wall_ns > 0"));
  for (const auto& [given, consents] : moments) {
    if (!forgotten.contains(given) || consents.of_several) continue;
    other.Bind(1, consents.visitor);
    bool all = true;
    while (all) {
      SLX_ASSIGN_OR_RETURN(const bool more, other.Step());
      if (!more) break;
      all = forgotten.contains(other.Integer(0));
    }
    other.Reset();
    if (all) visitors.push_back(consents.visitor);
  }
  return visitors;
}

// The number of consents that held until now. One transaction of the caller's.
Result<int64_t> FollowConsents(SessionIndex& index, const std::vector<LedgerEntry>& entries) {
  SLX_ASSIGN_OR_RETURN(const int64_t withdrawn, Withdraw(index.connection(), entries));
  SLX_RETURN_IF_ERROR(RemoveForgottenVisitors(index, entries).status());
  return withdrawn;
}

std::string ReasonOf(const std::string& detail) {
  const auto json = nlohmann::ordered_json::parse(detail, nullptr, false);
  const bool has = json.is_object() && json.contains("reason") && json["reason"].is_string();
  return has ? json["reason"].get<std::string>() : "forget";
}

// Blanks between members are a writer's taste.
bool SaysTheSame(const std::string& a, const std::string& b) {
  if (a == b) return true;
  if (!CheckNesting(a).ok() || !CheckNesting(b).ok()) return false;
  const auto first = nlohmann::ordered_json::parse(a, nullptr, false);
  const auto second = nlohmann::ordered_json::parse(b, nullptr, false);
  return !first.is_discarded() && first == second;
}

// '{}' while there is no certificate. Of several, which other stores or a forgetting that was broken off gave, the
// latest counts, in whatever order the chains are read. A certificate that the row has already keeps its text, every
// byte of it.
Status NoteDeletion(Connection& connection, const LedgerEntry& entry) {
  const bool done = entry.kind == LedgerKind::kForgotten;
  SLX_ASSIGN_OR_RETURN(
      auto insert, connection.Prepare(
                       "INSERT INTO deletions (session_id, deleted_wall_ns, reason, certificate_json)"
                       " VALUES (?1, ?2, ?3, ?4) ON CONFLICT (session_id) DO UPDATE SET deleted_wall_ns ="
                       " excluded.deleted_wall_ns, reason = excluded.reason, certificate_json ="
                       " excluded.certificate_json WHERE ?5 AND"
                       " (deletions.certificate_json = '{}' OR (excluded.deleted_wall_ns, excluded.certificate_json) >"
                       " (deletions.deleted_wall_ns, deletions.certificate_json))"));
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT certificate_json FROM deletions WHERE session_id = ?1"));
  for (const std::string& session : entry.sessions) {
    std::string certificate = done ? entry.detail_json : "{}";
    SLX_ASSIGN_OR_RETURN(const bool noted, select.Bind(1, session).Step());
    if (noted && SaysTheSame(select.Text(0), certificate)) certificate = select.Text(0);
    select.Reset();
    insert.Bind(1, session).Bind(2, entry.at.ns).Bind(3, ReasonOf(entry.detail_json));
    insert.Bind(4, certificate).Bind(5, int64_t{done});
    SLX_RETURN_IF_ERROR(insert.Run());
  }
  return Status::Ok();
}

// Withdrawals of the time before the ledger, which only the index knew: one entry a visitor. Of sessions whose consent
// was given by then: what was made under a later one stays. Row '' of ledger_heads
// says that it is done; saying a thing twice would change nothing.
Status RecordOldWithdrawals(SessionIndex& index, const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(const bool done, IsLedgerUp(index));
  if (done) return Status::Ok();
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  SLX_ASSIGN_OR_RETURN(auto select,
                       connection.Prepare("SELECT c.visitor, max(c.withdrawn_wall_ns), s.id FROM consents c"
                                          " JOIN (SELECT number, id, visitor, CASE WHEN json_valid(consent_json) THEN"
                                          " coalesce(nullif(json_extract(consent_json, '$.given_wall_ns'), 0),"
                                          " started_wall_ns) ELSE started_wall_ns END AS agreed_wall_ns FROM sessions"
                                          " WHERE kind = 'visitor') s ON s.visitor = c.visitor"
                                          " WHERE c.withdrawn_wall_ns IS NOT NULL AND (agreed_wall_ns <="
                                          " c.withdrawn_wall_ns OR agreed_wall_ns = c.given_wall_ns)"
                                          " GROUP BY s.number ORDER BY 1"));
  std::map<std::string, LedgerEntry> entries;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) break;
    if (ledger.WithdrawnAt(select.Text(2))) continue;
    LedgerEntry& entry = entries[select.Text(0)];
    entry.kind = LedgerKind::kWithdrawal;
    entry.at.ns = select.Integer(1);
    entry.sessions.push_back(select.Text(2));
  }
  for (const auto& [visitor, entry] : entries) SLX_RETURN_IF_ERROR(AppendToLedger(store, entry));
  return connection.Execute("INSERT INTO ledger_heads (chain, bytes) VALUES ('', 0)");
}

}  // namespace

Result<bool> RemoveForgottenVisitors(SessionIndex& index, const std::vector<LedgerEntry>& entries) {
  SLX_ASSIGN_OR_RETURN(const auto forgotten, VisitorsForgottenBy(index.connection(), entries));
  if (forgotten.empty()) return false;
  const auto visitors = [&index] { return index.connection().QueryInteger("SELECT count(*) FROM visitors"); };
  SLX_ASSIGN_OR_RETURN(const int64_t before, visitors());
  SLX_RETURN_IF_ERROR(RemoveForgottenRows(index, {}, forgotten));
  SLX_ASSIGN_OR_RETURN(const int64_t after, visitors());
  return after < before;
}

Status FollowLedger(SessionIndex& index, const fs::path& store) {
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(const auto heads, ReadHeads(connection));
  SLX_ASSIGN_OR_RETURN(const LedgerNews news, ReadLedgerNews(store, heads));
  if (!news.changed) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SLX_RETURN_IF_ERROR(FollowConsents(index, news.entries).status());
  for (const LedgerEntry& entry : news.entries)
    if (entry.kind == LedgerKind::kForgetting || entry.kind == LedgerKind::kForgotten)
      SLX_RETURN_IF_ERROR(NoteDeletion(connection, entry));
  SLX_RETURN_IF_ERROR(WriteHeads(connection, news.heads));
  return transaction.Commit();
}

Result<bool> FollowsLedger(SessionIndex& index, const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(const auto heads, ReadHeads(index.connection()));
  SLX_ASSIGN_OR_RETURN(const LedgerNews news, ReadLedgerNews(store, heads));
  return news.entries.empty();
}

Result<std::vector<WallNs>> HoldingThoughWithdrawn(SessionIndex& index, const Ledger& ledger) {
  SLX_ASSIGN_OR_RETURN(const auto moments, ConsentsByMoment(index.connection()));
  std::set<int64_t> withdrawn;
  for (const LedgerEntry& entry : ledger.entries())
    for (const WallNs given : ConsentsWithdrawnBy(entry)) withdrawn.insert(given.ns);
  std::vector<WallNs> held;
  for (const int64_t ns : withdrawn)
    if (const auto at = moments.find(ns); at != moments.end() && !at->second.holding.empty()) held.push_back({ns});
  return held;
}

Result<int64_t> FollowWithdrawals(SessionIndex& index, const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(index.connection()));
  SLX_ASSIGN_OR_RETURN(const int64_t withdrawn, FollowConsents(index, ledger.entries()));
  SLX_RETURN_IF_ERROR(transaction.Commit());
  return withdrawn;
}

namespace {

Result<TombstoneMoments> MomentsOf(SessionIndex& index, const char* question) {
  TombstoneMoments moments;
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare(question));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return moments;
    moments[select.Text(0)] = WallNs{select.Integer(1)};
  }
}

}  // namespace

Status TakeOverTombstones(SessionIndex& index, const fs::path& store) {
  std::error_code error;
  if (!fs::is_directory(store / "deletions", error)) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(
      const auto moments,
      MomentsOf(index, "SELECT session_id, deleted_wall_ns FROM deletions WHERE certificate_json <> '{}'"));
  return TakeOverOldTombstones(store, moments);
}

Status NoteTombstones(SessionIndex& expected, SessionIndex& index, const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(const auto moments, MomentsOf(index, "SELECT session_id, deleted_wall_ns FROM deletions"));
  SLX_ASSIGN_OR_RETURN(auto all, ReadOldTombstones(store));
  for (OldTombstone& old : all) {
    const auto moment = moments.find(old.entry.sessions.at(0));
    if (moment == moments.end()) continue;
    old.entry.at = moment->second;
    SLX_RETURN_IF_ERROR(NoteDeletion(expected.connection(), old.entry));
  }
  return Status::Ok();
}

Result<bool> IsLedgerUp(SessionIndex& index) {
  SLX_ASSIGN_OR_RETURN(const int64_t rows,
                       index.connection().QueryInteger("SELECT count(*) FROM ledger_heads WHERE chain = ''"));
  return rows != 0;
}

Status BringLedgerUp(SessionIndex& index, const fs::path& store) {
  SLX_RETURN_IF_ERROR(TakeOverTombstones(index, store));
  SLX_RETURN_IF_ERROR(MakeStoreId(store));
  SLX_RETURN_IF_ERROR(RecordOldWithdrawals(index, store));
  return FollowLedger(index, store);
}

}  // namespace stratalux::db
