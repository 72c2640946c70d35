// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <map>
#include <set>

#include "db/care/row_comparison.h"
#include "db/catalogue/ledger_follow.h"
#include "db/ledger/ledger.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Lines = std::vector<std::string>;

// A question whose every row is a complaint: what, and of which row.
Status Ask(Connection& connection, const std::string& file, const char* question, Lines& lines) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare(question));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    lines.push_back(file + ": " + select.Text(0));
  }
}

constexpr const char* kComplaints[] = {
    "SELECT 'sqlite_sequence.seq of sessions is ' || quote(q.seq) || ', but the number ' || max(s.number) || ' was "
    "given'"
    " FROM sessions s LEFT JOIN sqlite_sequence q ON q.name = 'sessions' GROUP BY q.name"
    " HAVING q.seq IS NULL OR typeof(q.seq) <> 'integer' OR q.seq < max(s.number)",
    "SELECT 'sessions.reasons_json of ' || id || ' is ' || quote(reasons_json) || ' while it is being recorded'"
    " FROM sessions WHERE status = 'recording' AND (reasons_json IS NOT '[]' OR finished_wall_ns IS NOT NULL)",
    "SELECT 'sessions.findings_json of ' || id || ' is ' || quote(findings_json) || ' and faults_json '"
    " || quote(faults_json) || ' while it is being recorded'"
    " FROM sessions WHERE status = 'recording' AND (findings_json IS NOT '[]' OR faults_json IS NOT '{}')",
    // A record's rig is that of a session that names it or accepted it.
    "SELECT 'calibrations.rig of ' || c.id || ' is ' || quote(c.rig) || '; no session that uses the record is of that "
    "rig'"
    " FROM calibrations c WHERE EXISTS (SELECT 1 FROM sessions u WHERE u.calibration_id = c.id)"
    " AND NOT EXISTS (SELECT 1 FROM sessions s WHERE s.calibration_id = c.id AND s.rig = c.rig)"
    " AND NOT EXISTS (SELECT 1 FROM accepted_calibrations a JOIN sessions s ON s.number = a.session"
    "                 WHERE a.calibration_id = c.id AND s.rig = c.rig)",
    "SELECT 'calibrations.made_wall_ns of ' || c.id || ' is ' || quote(c.made_wall_ns) || '; the fit that made it says "
    "'"
    " || max(a.made_wall_ns) FROM calibrations c JOIN accepted_calibrations a ON a.calibration_id = c.id GROUP BY c.id"
    " HAVING c.made_wall_ns IS NULL OR sum(a.made_wall_ns = c.made_wall_ns) = 0",
    "SELECT 'calibrations.made_wall_ns of ' || id || ' is ' || made_wall_ns || '; its record does not say so'"
    " FROM calibrations c WHERE made_wall_ns IS NOT NULL AND json_valid(record_json)"
    " AND made_wall_ns IS NOT json_extract(record_json, '$.made_wall_ns')"
    " AND NOT EXISTS (SELECT 1 FROM accepted_calibrations a WHERE a.calibration_id = c.id)"
    " AND NOT EXISTS (SELECT 1 FROM deletions)",
    // First seen at a consent or at a session; what was forgotten may have been earlier.
    "SELECT 'visitors.created_wall_ns of ' || quote(id) || ' is ' || created_wall_ns ||"
    " '; neither a consent nor a session is of that moment'"
    " FROM visitors v WHERE NOT EXISTS (SELECT 1 FROM deletions)"
    " AND NOT EXISTS (SELECT 1 FROM consents WHERE visitor = v.id AND given_wall_ns = v.created_wall_ns)"
    " AND NOT EXISTS (SELECT 1 FROM sessions WHERE visitor = v.id AND started_wall_ns = v.created_wall_ns)",
    // Frames, proofs and totals of a group are entered at once, also while a session is written.
    "SELECT 'sessions.frame_count of ' || s.id || ' is ' || s.frame_count || ' and stored_bytes ' || s.stored_bytes ||"
    " '; its rows are ' || count(f.frame) || ' frames up to ' || coalesce(max(f.frame), -1) || ' with ' ||"
    " coalesce(sum(f.stored_bytes), 0) || ' bytes and ' || count(p.frame) || ' proofs' FROM sessions s"
    " LEFT JOIN frames f ON f.session = s.number LEFT JOIN proofs p ON p.session = f.session AND p.frame = f.frame"
    " WHERE s.status = 'recording' GROUP BY s.number HAVING s.frame_count <> count(f.frame)"
    " OR count(f.frame) <> count(p.frame) OR s.frame_count <> coalesce(max(f.frame), -1) + 1"
    " OR s.stored_bytes <> coalesce(sum(f.stored_bytes), 0)"
    " OR (SELECT count(*) FROM proofs q WHERE q.session = s.number) <> s.frame_count",
};

// Rows that other files or the schema itself tell; no session is asked, whatever ?1 is.
constexpr TableRule kRules[] = {
    {"deletions", "?1 = ?1", "session_id", "", ""},
    {"retention_classes", "?1 = ?1", "retention", "", ""},
};

// The ledger is written first: a program that was stopped then leaves its rows to the next opening for writing.
Result<bool> LagsBehind(const fs::path& store, Connection& connection) {
  std::map<std::string, int64_t> heads;
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT chain, bytes FROM ledger_heads WHERE chain <> ''"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) break;
    heads[select.Text(0)] = select.Integer(1);
  }
  SLX_ASSIGN_OR_RETURN(const LedgerNews news, ReadLedgerNews(store, heads));
  return std::any_of(news.entries.begin(), news.entries.end(), [](const LedgerEntry& entry) {
    return entry.kind == LedgerKind::kForgetting || entry.kind == LedgerKind::kForgotten;
  });
}

// Of a certificate whose line in the ledger is damaged, which is said elsewhere, the index has the only copy.
Status TakeCertificates(Connection& expected, Connection& index) {
  SLX_ASSIGN_OR_RETURN(auto update,
                       expected.Prepare("UPDATE deletions SET deleted_wall_ns = ?2, reason = ?3, certificate_json = ?4"
                                        " WHERE session_id = ?1 AND certificate_json = '{}'"));
  SLX_ASSIGN_OR_RETURN(auto select,
                       index.Prepare("SELECT session_id, deleted_wall_ns, reason, certificate_json FROM deletions"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    update.Bind(1, select.Text(0)).Bind(2, select.Integer(1)).Bind(3, select.Text(2)).Bind(4, select.Text(3));
    SLX_RETURN_IF_ERROR(update.Run());
  }
}

Status CompareTables(const fs::path& store, const Ledger& ledger, SessionIndex& index, const std::string& file,
                     Lines& lines) {
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(const bool lags, LagsBehind(store, connection));
  SLX_ASSIGN_OR_RETURN(auto expected, SessionIndex::InMemory());
  SLX_RETURN_IF_ERROR(FollowLedger(expected, store));
  SLX_RETURN_IF_ERROR(NoteTombstones(expected, index, store));  // an older store that was only read so far
  if (!ledger.problems().empty()) SLX_RETURN_IF_ERROR(TakeCertificates(expected.connection(), connection));
  for (TableRule rule : kRules) {
    if (lags && std::string(rule.table) == "deletions") {
      // A forget is at work, or was stopped: the certificate of a row that has none yet may stand in the ledger.
      rule.rows = "?1 = ?1 AND certificate_json <> '{}'";
      rule.extent = TableRule::Extent::kRebuildHasMore;
    }
    SLX_ASSIGN_OR_RETURN(const auto differing, CompareRows(connection, expected.connection(), rule, 1, file));
    lines.insert(lines.end(), differing.begin(), differing.end());
  }
  return Status::Ok();
}

// A withdrawal of somebody who was captured stands in the ledger.
Status CompareWithdrawals(const Ledger& ledger, Connection& connection, const std::string& file, Lines& lines) {
  std::set<int64_t> moments;
  for (const LedgerEntry& entry : ledger.entries())
    if (entry.kind == LedgerKind::kWithdrawal) moments.insert(entry.at.ns);
  SLX_ASSIGN_OR_RETURN(
      auto select,
      connection.Prepare("SELECT withdrawn_wall_ns, quote(visitor) FROM consents c WHERE withdrawn_wall_ns"
                         " IS NOT NULL AND EXISTS (SELECT 1 FROM sessions s WHERE s.visitor = c.visitor AND"
                         " s.kind = 'visitor' AND (s.started_wall_ns <= c.withdrawn_wall_ns OR"
                         " c.withdrawn_wall_ns < c.given_wall_ns))"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    if (!moments.contains(select.Integer(0)))
      lines.push_back(file + ": consents.withdrawn_wall_ns of " + select.Text(1) + " is " + select.Text(0) +
                      "; no entry of the ledger is of that moment");
  }
}

}  // namespace

Result<std::vector<std::string>> CompareSchemas(Connection& index, const std::string& file) {
  SLX_ASSIGN_OR_RETURN(auto expected, SessionIndex::InMemory());
  // Tables of SQLite's own (sqlite_stat1 after ANALYZE) are nobody's schema.
  const auto read = [](Connection& connection) -> Result<std::map<std::string, std::string>> {
    SLX_ASSIGN_OR_RETURN(auto select,
                         connection.Prepare("SELECT type || ' ' || name, coalesce(sql, '') FROM"
                                            " sqlite_master WHERE name NOT LIKE 'sqlite\\_%' ESCAPE '\\'"));
    std::map<std::string, std::string> objects;
    while (true) {
      SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
      if (!more) return objects;
      objects[select.Text(0)] = select.Text(1);
    }
  };
  SLX_ASSIGN_OR_RETURN(const auto there, read(index));
  SLX_ASSIGN_OR_RETURN(const auto wanted, read(expected.connection()));
  Lines lines;
  for (const auto& [name, sql] : wanted) {
    const auto found = there.find(name);
    if (found == there.end())
      lines.push_back(file + ": the " + name + " of the schema is missing");
    else if (found->second != sql)
      lines.push_back(file + ": the " + name + " is not that of the schema");
  }
  for (const auto& [name, sql] : there)
    if (!wanted.contains(name)) lines.push_back(file + ": the " + name + " is not of the schema");
  return lines;
}

Result<std::vector<std::string>> CompareStore(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  Connection& connection = index.connection();
  const std::string file = (store / "index.sqlite").string();
  SLX_ASSIGN_OR_RETURN(Lines lines, CompareSchemas(connection, file));
  for (const char* complaint : kComplaints) SLX_RETURN_IF_ERROR(Ask(connection, file, complaint, lines));
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  SLX_RETURN_IF_ERROR(CompareTables(store, ledger, index, file, lines));
  SLX_ASSIGN_OR_RETURN(const bool up, IsLedgerUp(index));
  if (up) SLX_RETURN_IF_ERROR(CompareWithdrawals(ledger, connection, file, lines));
  return lines;
}

}  // namespace stratalux::db
