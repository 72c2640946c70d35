// SPDX-License-Identifier: Apache-2.0
#include "db/care/row_comparison.h"

#include <algorithm>
#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include "db/care/session_rebuild.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/manifest.h"
#include "shared/base/json_nesting.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using Extent = TableRule::Extent;

constexpr size_t kLinesATable = 5;
constexpr size_t kShownBytes = 100;

std::set<std::string> Names(const std::string& list) {
  std::set<std::string> names;
  size_t from = 0;
  while (from < list.size()) {
    const size_t comma = std::min(list.find(',', from), list.size());
    const size_t start = list.find_first_not_of(' ', from);
    names.insert(list.substr(start, comma - start));
    from = comma + 1;
  }
  return names;
}

Result<std::vector<std::string>> ColumnsOf(Connection& connection, const std::string& table) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT name FROM pragma_table_info(?1) ORDER BY cid"));
  select.Bind(1, table);
  std::vector<std::string> columns;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return columns;
    columns.push_back(select.Text(0));
  }
}

// Each value as an SQL literal, which tells 1 from '1' and a blob from a text, and every bit of a real number.
using Row = std::vector<std::string>;
Result<std::map<std::string, Row>> RowsOf(Connection& connection, const TableRule& rule,
                                          const std::vector<std::string>& columns, int64_t number) {
  std::string sql = "SELECT ";
  std::string key;
  for (const std::string& column : Names(rule.key))
    key += (key.empty() ? "'" : " || ', ") + column + " ' || quote(\"" + column + "\")";
  sql += key;
  for (const std::string& column : columns) sql += ", quote(\"" + column + "\")";
  sql += std::string(" FROM ") + rule.table + " WHERE " + rule.rows;
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare(sql));
  select.Bind(1, number);
  std::map<std::string, Row> rows;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return rows;
    Row row;
    for (size_t i = 0; i < columns.size(); ++i) row.push_back(select.Text(static_cast<int>(i) + 1));
    rows.emplace(select.Text(0), std::move(row));
  }
}

// For a line on a terminal.
std::string Shown(const std::string& value) {
  std::string text = value.substr(0, kShownBytes);
  for (char& c : text)
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  return value.size() > kShownBytes ? text + "..." : text;
}

// The text of an SQL literal; nothing for NULL and blobs.
std::optional<std::string> TextOf(const std::string& literal) {
  if (literal.size() < 2 || literal.front() != '\'') return std::nullopt;
  std::string text;
  for (size_t i = 1; i + 1 < literal.size(); ++i) {
    text += literal[i];
    if (literal[i] == '\'') ++i;  // doubled
  }
  return text;
}

bool AreEqual(const std::string& column, const std::string& a, const std::string& b) {
  if (a == b) return true;
  if (!column.ends_with("_json")) return false;
  // Blanks between members are a writer's taste.
  const auto one = TextOf(a), other = TextOf(b);
  if (!one || !other || !CheckNesting(*one).ok() || !CheckNesting(*other).ok()) return false;
  const Json first = Json::parse(*one, nullptr, false), second = Json::parse(*other, nullptr, false);
  return !first.is_discarded() && !second.is_discarded() && first == second;
}

}  // namespace

const std::vector<TableRule>& SessionTables() {
  static const std::vector<TableRule> kTables = {
      {"sessions", "number = ?1", "number", "", ""},
      {"frames", "session = ?1", "frame", "", ""},
      {"proofs", "session = ?1", "frame", "", ""},
      {"fits", "session = ?1", "id", "", ""},
      {"metrics", "session = ?1", "fit, name", "", ""},
      {"accepted_calibrations", "session = ?1", "fit", "", ""},
      {"calibrations",
       "id IN (SELECT calibration_id FROM sessions WHERE number = ?1"
       " UNION SELECT calibration_id FROM accepted_calibrations WHERE session = ?1)",
       "id", "rig, made_wall_ns", "of the session that brought the record first; CompareStore looks at all of them"},
      {"visitors", "id = (SELECT visitor FROM sessions WHERE number = ?1)", "id", "created_wall_ns",
       "when the visitor first came may be before the first session that is left", Extent::kIndexHasMore},
      {"consents", "visitor = (SELECT visitor FROM sessions WHERE number = ?1)",
       "visitor, text_version, language, fit, research, publication, given_wall_ns", "number, withdrawn_wall_ns",
       "the order of consents is the index's own; a withdrawal is the ledger's (CompareStore)", Extent::kIndexHasMore},
  };
  return kTables;
}

const std::vector<StoreTable>& StoreTables() {
  static const std::vector<StoreTable> kTables = {
      {"deletions", "of sessions that are gone; CompareStore holds them against the ledger"},
      {"ledger_heads", "how far the index has read; what it read is compared"},
      {"retention_classes", "the schema's own; CompareStore"},
      {"jobs", "what is to be done, not what was captured"},
      {"job_fence", "the last token given to a job"},
      {"job_counts", "kept by triggers on jobs"},
      {"access_log", "outlives the sessions it speaks of"},
      {"sqlite_sequence", "CompareStore: no lower than any number given"},
  };
  return kTables;
}

Result<std::vector<std::string>> CompareRows(Connection& index, Connection& rebuilt, const TableRule& rule,
                                             int64_t number, const std::string& file) {
  SLX_ASSIGN_OR_RETURN(const auto all, ColumnsOf(rebuilt, rule.table));
  const auto left_out = Names(rule.left_out);
  std::vector<std::string> columns;
  for (const std::string& column : all)
    if (!left_out.contains(column)) columns.push_back(column);
  SLX_ASSIGN_OR_RETURN(const auto there, RowsOf(index, rule, columns, number));
  SLX_ASSIGN_OR_RETURN(const auto expected, RowsOf(rebuilt, rule, columns, number));
  std::vector<std::string> lines;
  size_t unsaid = 0;
  const auto say = [&](const std::string& line) {
    if (lines.size() < kLinesATable)
      lines.push_back(file + ": " + line);
    else
      ++unsaid;
  };
  for (const auto& [key, row] : expected) {
    const auto found = there.find(key);
    if (found == there.end()) {
      if (rule.extent != Extent::kRebuildHasMore)
        say(std::string(rule.table) + " lacks the row " + Shown(key) + ", which the session's files hold");
      continue;
    }
    for (size_t i = 0; i < columns.size(); ++i)
      if (!AreEqual(columns[i], found->second[i], row[i]))
        say(std::string(rule.table) + "." + columns[i] + " of " + Shown(key) + " is " + Shown(found->second[i]) +
            "; the session's files say " + Shown(row[i]));
  }
  for (const auto& [key, row] : there)
    if (rule.extent != Extent::kIndexHasMore && !expected.contains(key))
      say(std::string(rule.table) + " has the row " + Shown(key) + ", which the session's files do not hold");
  if (unsaid > 0) lines.push_back(file + ": " + rule.table + " differs in " + std::to_string(unsaid) + " more places");
  return lines;
}

namespace {

// A rule with other columns left out, for sessions whose files tell less.
TableRule With(TableRule rule, const char* left_out, Extent extent) {
  rule.left_out = left_out;
  rule.extent = extent;
  return rule;
}

std::vector<TableRule> RulesFor(const SessionRow& session, const fs::path& folder, const RebuiltSession& rebuilt) {
  std::vector<TableRule> rules = SessionTables();
  const auto manifest = ReadManifest(folder);
  const auto contents = ReadManifestContents(folder);
  for (TableRule& rule : rules) {
    const std::string table = rule.table;
    // Being written, or to be ended by the next opening: its ending is not there yet.
    if (session.info.status == SessionStatus::kRecording) {
      constexpr const char* kEnding =
          "status, reasons_json, finished_wall_ns, findings_json, faults_json, frame_count, stored_bytes";
      constexpr const char* kEndingAndKey =
          "status, reasons_json, finished_wall_ns, findings_json, faults_json, frame_count, stored_bytes, key_id";
      // Its key is known by its frames.
      if (table == "sessions") rule = With(rule, session.frames == 0 ? kEndingAndKey : kEnding, Extent::kSame);
      if (table == "frames" || table == "proofs") rule.extent = Extent::kRebuildHasMore;
    } else if (table == "sessions" && !manifest.ok()) {
      // Lost, or never written by a disk that was full: what only a manifest tells is the index's alone.
      rule = With(rule,
                  "kind, rig, visitor, consent, simulated, seed, started_wall_ns, status, reasons_json,"
                  " program_version, plan_json, planned_steps, calibration_id, consent_json, retention,"
                  " finished_wall_ns, visit, attempt, findings_json, faults_json, key_id",
                  Extent::kSame);
    } else if (table == "sessions" && session.info.status == SessionStatus::kFailed &&
               manifest->status == SessionStatus::kRecording) {
      // It failed on a disk that took no second manifest: reason and findings are the index's alone.
      rule = With(rule, "reasons_json, finished_wall_ns, findings_json, faults_json, key_id", Extent::kSame);
    } else if (table == "sessions" && session.frames == 0) {
      rule = With(rule, "key_id", Extent::kSame);  // known by its frames
    } else if (table == "sessions" && contents.ok() && contents->schema == 1) {
      rule = With(rule, "consent_json, finished_wall_ns", Extent::kSame);  // columns that came with schema 2
    } else if (table == "sessions" && !rebuilt.loss.empty()) {
      // The loss itself is a finding; a reindex told it with what an older index knew of the lost frames.
      rule = With(rule, "reasons_json", Extent::kSame);
    }
    if (table == "consents" && contents.ok() && contents->schema == 1) rule.extent = Extent::kIndexHasMore;
    if (table == "calibrations" && !manifest.ok()) rule.extent = Extent::kIndexHasMore;
  }
  return rules;
}

// A fit whose registration was broken off behind its last file lies there whole and is not listed, or is listed as the
// earlier one whose place it took: nothing that was promised is missing.
Status SetUnlistedAside(SessionIndex& index, int64_t number, const fs::path& folder, RebuiltSession& rebuilt,
                        std::vector<std::string>& notes) {
  SLX_ASSIGN_OR_RETURN(const auto rows, index.Fits(number, rebuilt.info.id));
  std::vector<FitRow> listed;
  for (FitRow& fit : rebuilt.fits) {
    const auto row = std::find_if(rows.begin(), rows.end(), [&](const FitRow& other) { return other.id == fit.id; });
    const fs::path place = folder / "fits" / fit.id;
    if (row == rows.end()) {
      notes.push_back(place.string() +
                      " is a fit that the index does not list: its registration was broken off, or its row removed;"
                      " `stratalux-db reindex` lists it");
      continue;
    }
    // Other figures, too: a time alone that differs is damage.
    if (fit.created_wall.ns > row->created_wall.ns && fit.metrics_json != row->metrics_json &&
        fit.options_json == row->options_json && fit.calibration_json.empty() && CheckFitFiles(place).ok()) {
      notes.push_back(place.string() +
                      " is newer than what the index lists of it: its registration was broken off; `stratalux-fit run`"
                      " of the session, or `stratalux-db reindex`, ends it");
      fit = *row;
    }
    listed.push_back(std::move(fit));
  }
  rebuilt.fits = std::move(listed);
  return Status::Ok();
}

Result<std::vector<std::string>> CompareSessionRows(const fs::path& store, const SessionRow& session,
                                                    std::vector<std::string>& notes) {
  const fs::path folder = store / "sessions" / session.info.id;
  const std::string file = (store / "index.sqlite").string();
  const std::string prefix = "session " + session.info.id + ": ";
  std::vector<std::string> lines;
  SLX_ASSIGN_OR_RETURN(auto rebuilt, RebuildSession(folder));
  // Which frames the findings withdraw is by the index's own where no manifest tells them, or none that it knows yet.
  const auto ending = ReadManifest(folder);
  if (session.info.status == SessionStatus::kRecording || !ending.ok() || ending->status == SessionStatus::kRecording)
    rebuilt.info.found = session.info.found;
  // What became of the manifest is told by whoever reads it.
  const std::string manifest = (folder / "manifest.json").string();
  for (const std::string& problem : rebuilt.problems)
    if (!problem.starts_with(manifest)) lines.push_back(problem);
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const int64_t number, index.NumberOf(session.info.id));
  if (rebuilt.number && *rebuilt.number != number)
    lines.push_back(file + ": sessions.number of " + session.info.id + " is " + std::to_string(number) + "; " +
                    folder.string() + " says " + std::to_string(*rebuilt.number));
  SLX_RETURN_IF_ERROR(SetUnlistedAside(index, number, folder, rebuilt, notes));
  SLX_ASSIGN_OR_RETURN(auto expected, SessionIndex::TablesInMemory());
  SLX_RETURN_IF_ERROR(InsertRebuilt(expected, rebuilt, number).status());
  for (const TableRule& rule : RulesFor(session, folder, rebuilt)) {
    SLX_ASSIGN_OR_RETURN(const auto differing,
                         CompareRows(index.connection(), expected.connection(), rule, number, file));
    for (const std::string& line : differing) lines.push_back(prefix + line);
  }
  return lines;
}

}  // namespace

std::vector<std::string> CompareSession(const fs::path& store, const SessionRow& session,
                                        std::vector<std::string>& notes) {
  auto lines = CompareSessionRows(store, session, notes);
  if (lines.ok()) return std::move(lines).value();
  return {"session " + session.info.id + " cannot be rebuilt from its files: " + lines.status().message()};
}

}  // namespace stratalux::db
