// SPDX-License-Identifier: Apache-2.0
#include "db/apps/serve/site.h"

#include "db/catalogue/manifest.h"
#include "db/catalogue/schema_check.h"
#include "db/serve_style.h"

namespace stratalux::db {
namespace {

constexpr const char* kSession = R"(
SELECT number, id, kind, rig, visitor, consent_json, retention, simulated, seed, started_wall_ns,
       coalesce(finished_wall_ns, 0), status, reasons_json, program_version, frame_count, stored_bytes,
       coalesce(lower(hex(key_id)), ''), coalesce(calibration_id, ''),
       (SELECT c.withdrawn_wall_ns FROM session_consents c WHERE c.session = sessions.number),
       visit, attempt, findings_json, faults_json
FROM sessions WHERE id = :session)";

constexpr const char* kIcon =
    R"(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><rect width="16" height="16" rx="3" fill="#1f5f6b"/>)"
    R"(<path d="M3 5h10M3 8h10M3 11h10" stroke="#fff" stroke-width="1.5"/></svg>)";

std::optional<WallNs> MomentOf(const Cell& cell) {
  return std::holds_alternative<int64_t>(cell) ? std::optional(WallNs{IntegerOf(cell)}) : std::nullopt;
}

Result<ServedSession> SessionOf(const std::vector<Cell>& row) {
  ServedSession session;
  SessionInfo& info = session.info;
  session.number = IntegerOf(row[0]);
  info.id = TextOf(row[1]);
  SLX_ASSIGN_OR_RETURN(info.kind, ParseSessionKind(TextOf(row[2])));
  info.rig = TextOf(row[3]);
  info.visitor = TextOf(row[4]);
  info.consent = ConsentFromJson(TextOf(row[5]));
  SLX_ASSIGN_OR_RETURN(info.retention, ParseRetention(TextOf(row[6])));
  info.simulated = IntegerOf(row[7]) != 0;
  info.seed = static_cast<uint64_t>(IntegerOf(row[8]));
  info.started_wall.ns = IntegerOf(row[9]);
  info.finished_wall.ns = IntegerOf(row[10]);
  SLX_ASSIGN_OR_RETURN(info.status, ParseSessionStatus(TextOf(row[11])));
  info.reasons = ReasonsFromJson(TextOf(row[12]));
  info.program_version = TextOf(row[13]);
  session.frames = IntegerOf(row[14]);
  session.bytes = IntegerOf(row[15]);
  session.key_id = TextOf(row[16]);
  session.calibration = TextOf(row[17]);
  session.withheld = WhyWithheld(info.kind, info.consent, MomentOf(row[18]));
  info.visit = TextOf(row[19]);
  info.attempt = static_cast<int>(IntegerOf(row[20]));
  info.found = FoundFromJson(TextOf(row[21]), TextOf(row[22]));
  return session;
}

}  // namespace

int64_t IntegerOf(const Cell& cell) {
  const auto* value = std::get_if<int64_t>(&cell);
  return value == nullptr ? 0 : *value;
}
double RealOf(const Cell& cell) {
  const auto* value = std::get_if<double>(&cell);
  return value == nullptr ? static_cast<double>(IntegerOf(cell)) : *value;
}
std::string TextOf(const Cell& cell) {
  const auto* value = std::get_if<std::string>(&cell);
  return value == nullptr ? "" : *value;
}

Result<ReadOnlyIndex> Site::OpenIndex() const {
  SLX_RETURN_IF_ERROR(RequireCurrentSchema(store_));
  return ReadOnlyIndex::Open(store_);
}

Result<ServedSession> Site::Find(ReadOnlyIndex& index, const std::string& id) {
  SLX_ASSIGN_OR_RETURN(const bool forgotten, IsForgotten(log_.ledger(), index, id));
  if (forgotten) return Status::NotFound("session '" + id + "' was forgotten; its certificate is among the deletions");
  SLX_ASSIGN_OR_RETURN(const auto table, index.Run(kSession, {{"session", id}}));
  if (table.rows.empty()) return Status::NotFound("no session '" + id + "' in this store");
  SLX_ASSIGN_OR_RETURN(ServedSession session, SessionOf(table.rows.front()));
  if (session.withheld.empty()) {  // what stands in the ledger alone
    SLX_ASSIGN_OR_RETURN(const auto withdrawn, log_.ledger().WithdrawnAt(id));
    session.withheld = WhyWithheld(session.info.kind, session.info.consent, withdrawn);
  }
  return session;
}

Result<ServedSession> Site::Disclose(const std::string& id, const std::string& what, const std::string& peer) {
  SLX_ASSIGN_OR_RETURN(auto index, OpenIndex());
  SLX_ASSIGN_OR_RETURN(auto session, Find(index, id));
  if (!session.withheld.empty()) return Status::Usage("pictures and reports are not shown: " + session.withheld);
  SLX_RETURN_IF_ERROR(log_.Enter(id, what, peer));
  return session;
}

http::Router RoutesOf(Site& site) {
  http::Router router;
  const auto open = http::Audience::kEverybody;
  router.Add(
      http::Method::kGet, "/style.css",
      [](const http::Request&) { return http::Response::Of("text/css; charset=utf-8", kServeStyle); }, open);
  router.Add(
      http::Method::kGet, "/icon.svg", [](const http::Request&) { return http::Response::Of("image/svg+xml", kIcon); },
      open);
  AddStorePages(site, router);
  AddSessionPages(site, router);
  AddFramePages(site, router);
  AddFitPages(site, router);
  AddQueryPages(site, router);
  return router;
}

}  // namespace stratalux::db
