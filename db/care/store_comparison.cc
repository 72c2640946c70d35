// SPDX-License-Identifier: Apache-2.0
#include <map>

#include <nlohmann/json.hpp>

#include "db/care/row_comparison.h"
#include "db/ledger/tombstone.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
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
    // A record's rig is that of a session that names it or accepted it.
    "SELECT 'calibrations.rig of ' || c.id || ' is ' || quote(c.rig) || '; no session that uses the record is of that "
    "rig'"
    " FROM calibrations c WHERE c.rig <> '' AND EXISTS (SELECT 1 FROM sessions u WHERE u.calibration_id = c.id)"
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
};

// What `reindex` would make of a certificate; of a damaged one its name alone counts.
Lines CompareDeletion(const fs::path& certificate, Statement& row, const std::string& file) {
  Lines lines;
  const std::string id = certificate.stem().string();
  const auto text = ReadFile(certificate);
  if (!text.ok()) return {text.status().message()};
  const Json json = Json::parse(*text, nullptr, false);
  if (!json.is_object()) return {certificate.string() + ": no JSON object; its session stays forgotten"};
  const auto differs = [&](const char* column, const std::string& there, const std::string& said) {
    lines.push_back(file + ": deletions." + column + " of " + id + " is " + there + "; " + certificate.string() +
                    " says " + said);
  };
  const Json at = json.value("deleted_wall_ns", Json()), reason = json.value("reason", Json());
  if (!at.is_number_integer() || at != row.Integer(0)) differs("deleted_wall_ns", row.Text(0), at.dump());
  if (!reason.is_string() || reason != row.Text(1)) differs("reason", row.Text(1), reason.dump());
  const Json kept = Json::parse(row.Text(2), nullptr, false);
  if (kept != json) differs("certificate_json", "another text", "what lies there");
  return lines;
}

Status CompareDeletions(const fs::path& store, Connection& connection, const std::string& file, Lines& lines) {
  std::map<std::string, fs::path> certificates;
  for (const fs::path& path : ListTombstones(store)) certificates[path.stem().string()] = path;
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT deleted_wall_ns, reason, certificate_json, session_id"
                                                       " FROM deletions"));
  std::error_code error;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) break;
    const std::string id = select.Text(3);
    const auto found = certificates.find(id);
    if (found != certificates.end()) {
      for (std::string& line : CompareDeletion(found->second, select, file)) lines.push_back(std::move(line));
      certificates.erase(found);
    } else if (!HasTombstone(store, id)) {
      lines.push_back(file + ": deletions has the row " + id + ", but " + CertificateFile(store, id).string() +
                      " is not there");
    }
  }
  for (const auto& [id, path] : certificates)
    lines.push_back(file + ": deletions lacks the row " + id + " of " + path.string());
  return Status::Ok();
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
  SLX_RETURN_IF_ERROR(CompareDeletions(store, connection, file, lines));
  return lines;
}

}  // namespace stratalux::db
