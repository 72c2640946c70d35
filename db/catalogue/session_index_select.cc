// SPDX-License-Identifier: Apache-2.0
// What the index is asked; session_index.cc opens and writes it.
#include "db/catalogue/manifest.h"
#include "db/catalogue/session_index.h"

namespace stratalux::db {
namespace {

// What a summary has; plan, calibration and findings follow in whole rows.
constexpr const char* kSummaryColumns =
    "SELECT s.id, s.kind, s.rig, s.visitor, s.consent_json, s.simulated, s.seed, s.started_wall_ns, s.status,"
    " s.reasons_json, s.program_version, s.frame_count, s.stored_bytes, s.retention, coalesce(s.finished_wall_ns, 0),"
    " s.consent, lower(hex(s.key_id)), s.visit, s.attempt";
constexpr int kPlanColumn = 19, kCalibrationColumn = 20, kFindingsColumn = 21, kFaultsColumn = 22;

Status ReadSummary(const Statement& select, SessionSummary& row) {
  row.info.id = select.Text(0);
  const auto column = [&row](const char* name) {
    return "index: sessions." + std::string(name) + " of " + row.info.id;
  };
  SLX_ASSIGN_OR_RETURN(row.info.kind, ParseSessionKind(select.Text(1)).WithContext(column("kind")));
  row.info.rig = select.Text(2);
  row.info.visitor = select.Text(3);
  row.info.consent = ConsentFromJson(select.Text(4));
  if (row.info.consent.text_version.empty()) row.info.consent.text_version = select.Text(15);  // schema 1
  row.info.simulated = select.Integer(5) != 0;
  row.info.seed = static_cast<uint64_t>(select.Integer(6));
  row.info.started_wall.ns = select.Integer(7);
  SLX_ASSIGN_OR_RETURN(row.info.status, ParseSessionStatus(select.Text(8)).WithContext(column("status")));
  row.info.reasons = ReasonsFromJson(select.Text(9));
  row.info.program_version = select.Text(10);
  row.frames = select.Integer(11);
  row.bytes = select.Integer(12);
  SLX_ASSIGN_OR_RETURN(row.info.retention, ParseRetention(select.Text(13)).WithContext(column("retention")));
  row.info.finished_wall.ns = select.Integer(14);
  row.key_id = select.Text(16);
  row.info.visit = select.Text(17);
  row.info.attempt = static_cast<int>(select.Integer(18));
  return Status::Ok();
}

Result<std::vector<SessionSummary>> ReadSummaries(Statement& select) {
  std::vector<SessionSummary> rows;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return rows;
    SLX_RETURN_IF_ERROR(ReadSummary(select, rows.emplace_back()));
  }
}

Result<std::vector<SessionRow>> ReadRows(Statement& select) {
  std::vector<SessionRow> rows;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return rows;
    SessionRow& row = rows.emplace_back();
    SLX_RETURN_IF_ERROR(ReadSummary(select, row));
    row.info.plan_json = select.Text(kPlanColumn);
    row.info.calibration_json = select.Text(kCalibrationColumn);
    row.info.found = FoundFromJson(select.Text(kFindingsColumn), select.Text(kFaultsColumn));
  }
}

std::string WholeRows(const std::string& where) {
  return std::string(kSummaryColumns) +
         ", s.plan_json, coalesce(c.record_json, ''), s.findings_json, s.faults_json FROM sessions s"
         " LEFT JOIN calibrations c ON c.id = s.calibration_id WHERE " +
         where;
}

// The first text behind all that begin with `prefix`; empty: there is none.
std::string EndOfPrefix(std::string prefix) {
  while (!prefix.empty() && static_cast<unsigned char>(prefix.back()) == 0xff) prefix.pop_back();
  if (!prefix.empty()) ++prefix.back();
  return prefix;
}

}  // namespace

Result<std::vector<SessionSummary>> SessionIndex::Sessions() {
  SLX_ASSIGN_OR_RETURN(auto select,
                       connection_.Prepare(std::string(kSummaryColumns) + " FROM sessions s ORDER BY s.number DESC"));
  return ReadSummaries(select);
}

Result<std::vector<SessionSummary>> SessionIndex::SessionsOf(const std::string& visitor) {
  SLX_ASSIGN_OR_RETURN(auto select,
                       connection_.Prepare(std::string(kSummaryColumns) +
                                           " FROM sessions s WHERE s.visitor = ?1 ORDER BY s.number DESC"));
  select.Bind(1, visitor);
  return ReadSummaries(select);
}

Result<SessionRow> SessionIndex::Session(int64_t number) {
  SLX_ASSIGN_OR_RETURN(auto select, connection_.Prepare(WholeRows("s.number = ?1")));
  select.Bind(1, number);
  SLX_ASSIGN_OR_RETURN(auto rows, ReadRows(select));
  if (rows.empty()) return Status::NotFound("no session number " + std::to_string(number));
  return std::move(rows.front());
}

Result<std::vector<SessionRow>> SessionIndex::Recording() {
  SLX_ASSIGN_OR_RETURN(auto select, connection_.Prepare(WholeRows("s.status = 'recording' ORDER BY s.number DESC")));
  return ReadRows(select);
}

Result<bool> SessionIndex::HasUnfinished() {
  SLX_ASSIGN_OR_RETURN(auto select, connection_.Prepare("SELECT 1 FROM sessions WHERE status = 'recording' LIMIT 1"));
  return select.Step();
}

Result<std::vector<int64_t>> SessionIndex::Select(const std::string& selector) {
  std::vector<int64_t> numbers;
  if (selector.empty()) return numbers;
  if (selector == "latest") {
    // The newest session that has a frame owns the last row of `frames`.
    SLX_ASSIGN_OR_RETURN(auto select, connection_.Prepare("SELECT max(session) FROM frames"));
    SLX_RETURN_IF_ERROR(select.Step().status());
    if (select.Integer(0) > 0) return std::vector<int64_t>{select.Integer(0)};
  }
  if (const auto number = NumberOf(selector); number.ok()) return std::vector<int64_t>{*number};
  const std::string end = EndOfPrefix(selector);
  SLX_ASSIGN_OR_RETURN(
      auto select, connection_.Prepare(end.empty() ? "SELECT number FROM sessions WHERE id >= ?1 ORDER BY id LIMIT 3"
                                                   : "SELECT number FROM sessions WHERE id >= ?1 AND id < ?2"
                                                     " ORDER BY id LIMIT 3"));
  select.Bind(1, selector);
  if (!end.empty()) select.Bind(2, end);
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return numbers;
    numbers.push_back(select.Integer(0));
  }
}

Result<int64_t> SessionIndex::NumberOf(const std::string& id) {
  SLX_ASSIGN_OR_RETURN(auto select, connection_.Prepare("SELECT number FROM sessions WHERE id = ?1"));
  select.Bind(1, id);
  SLX_ASSIGN_OR_RETURN(const bool found, select.Step());
  if (!found) return Status::NotFound("no session " + id);
  return select.Integer(0);
}

Result<std::vector<SessionIndex::Place>> SessionIndex::Places(int64_t number) {
  SLX_ASSIGN_OR_RETURN(auto select, connection_.Prepare("SELECT frame, segment, offset, stored_bytes, hash,"
                                                        " level_check FROM frames WHERE session = ?1 ORDER BY frame"));
  select.Bind(1, number);
  std::vector<Place> places;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return places;
    places.push_back({select.Integer(0), select.Integer(1), select.Integer(2), select.Integer(3), select.Blob(4),
                      select.Integer(5) == static_cast<int64_t>(LevelCheck::kFailed)});
  }
}

Result<std::vector<FitRow>> SessionIndex::Fits(int64_t number, const std::string& session) {
  SLX_ASSIGN_OR_RETURN(auto select,
                       connection_.Prepare("SELECT id, options_json, metrics_json, created_wall_ns FROM fits"
                                           " WHERE session = ?1 ORDER BY created_wall_ns DESC"));
  select.Bind(1, number);
  std::vector<FitRow> fits;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return fits;
    fits.push_back({select.Text(0), session, select.Text(1), select.Text(2), {select.Integer(3)}});
  }
}

Result<bool> SessionIndex::IsEncrypted(const std::string& id) {
  SLX_ASSIGN_OR_RETURN(auto select, connection_.Prepare("SELECT 1 FROM sessions WHERE id = ?1 AND key_id IS NOT NULL"));
  return select.Bind(1, id).Step();
}

}  // namespace stratalux::db
