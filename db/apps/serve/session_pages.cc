// SPDX-License-Identifier: Apache-2.0
// The list of sessions with its filters, and one session.
#include <algorithm>
#include <charconv>

#include "db/apps/display_text.h"
#include "db/apps/moment.h"
#include "db/apps/serve/html.h"
#include "db/apps/serve/site.h"
#include "db/apps/table_output.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/session_filter.h"
#include "shared/http/target.h"

namespace stratalux::db {
namespace {

using http::Request;
using http::Response;

constexpr int64_t kListed = 50;
constexpr int64_t kMostListed = 1000;

Result<SessionFilter> FilterOf(const Request& request) {
  SessionFilter filter;
  if (const std::string text = request.Query("status"); !text.empty()) {
    const auto status = ParseSessionStatus(text);
    if (!status.ok()) return Status::Usage("status must be recording, complete, degraded or failed");
    filter.statuses.push_back(*status);
  }
  if (const std::string text = request.Query("kind"); !text.empty()) {
    const auto kind = ParseSessionKind(text);
    if (!kind.ok()) return Status::Usage("kind must be visitor, calibration, dark, flat or response");
    filter.kinds.push_back(*kind);
  }
  if (const std::string text = request.Query("rig"); !text.empty()) filter.rigs.push_back(text);
  if (const std::string text = request.Query("visitor"); !text.empty()) filter.visitors.push_back(text);
  if (const std::string text = request.Query("visit"); !text.empty()) filter.visits.push_back(text);
  if (const std::string text = request.Query("since"); !text.empty()) {
    SLX_ASSIGN_OR_RETURN(filter.since, ParseMoment(text, WallNow()).WithContext("since"));
  }
  filter.limit = kListed;
  if (const std::string text = request.Query("limit"); !text.empty()) {
    int64_t limit = 0;
    const auto end = std::from_chars(text.data(), text.data() + text.size(), limit);
    if (end.ptr != text.data() + text.size() || limit < 1 || limit > kMostListed)
      return Status::Usage("limit must be a number from 1 to " + std::to_string(kMostListed));
    filter.limit = limit;
  }
  return filter;
}

std::string Select(const std::string& name, const std::string& label, const std::vector<std::string>& values,
                   const std::string& chosen) {
  std::string options = "<option value=\"\">any</option>";
  for (const std::string& value : values)
    options += "<option value=\"" + Escape(value) + "\"" + (value == chosen ? " selected" : "") + ">" + Escape(value) +
               "</option>";
  return "<p><label for=\"" + name + "\">" + label + "</label><select id=\"" + name + "\" name=\"" + name + "\">" +
         options + "</select></p>";
}

std::string Input(const std::string& name, const std::string& label, const std::string& value,
                  const std::string& hint) {
  return "<p><label for=\"" + name + "\">" + label + "</label><input id=\"" + name + "\" name=\"" + name +
         "\" value=\"" + Escape(value) + "\" placeholder=\"" + hint + "\"></p>";
}

Result<std::string> FilterForm(ReadOnlyIndex& index, const Request& request) {
  SLX_ASSIGN_OR_RETURN(const auto table, index.Run("SELECT DISTINCT rig FROM sessions ORDER BY rig LIMIT 200"));
  std::vector<std::string> rigs;
  for (const auto& row : table.rows)
    if (!TextOf(row[0]).empty()) rigs.push_back(TextOf(row[0]));
  return "<form method=\"get\" action=\"/sessions\" role=\"search\" aria-label=\"Filter the sessions\">" +
         Select("status", "Status", {"recording", "complete", "degraded", "failed"}, request.Query("status")) +
         Select("kind", "Kind", {"visitor", "calibration", "dark", "flat", "response"}, request.Query("kind")) +
         Select("rig", "Rig", rigs, request.Query("rig")) +
         Input("visitor", "Visitor", request.Query("visitor"), "pseudonym") +
         Input("visit", "Visit", request.Query("visit"), "its attempts") +
         Input("since", "Since", request.Query("since"), "7d or 2026-11-21") +
         "<p class=\"buttons\"><button type=\"submit\">Filter</button> <a href=\"/sessions\">Show all</a></p></form>";
}

std::string Thumbnail(const std::string& id, int64_t frames) {
  if (frames == 0) return "<span class=\"nothing\">no frame</span>";
  return "<img class=\"thumb\" loading=\"lazy\" width=\"96\" height=\"72\" alt=\"\" src=\"/thumbnails/" +
         http::PercentEncode(id) + "\">";
}

std::string RowOf(const std::vector<Cell>& row) {
  const std::string id = TextOf(row[0]);
  const auto cell = [&row](size_t c, ColumnKind kind) {
    return "<td>" + Escape(CellForPeople(row[c], kind)) + "</td>";
  };
  const auto number = [&row](size_t c, ColumnKind kind) {
    return "<td class=\"number\">" + Escape(CellForPeople(row[c], kind)) + "</td>";
  };
  return "<tr><td>" + Thumbnail(id, IntegerOf(row[6])) + "</td><th scope=\"row\">" + Link(SessionPlace(id), id) +
         "</th>" + cell(1, ColumnKind::kWallTime) + cell(2, ColumnKind::kPlain) + cell(3, ColumnKind::kPlain) +
         cell(4, ColumnKind::kPlain) + "<td>" + StatusWord(TextOf(row[5])) + "</td>" + number(6, ColumnKind::kPlain) +
         number(7, ColumnKind::kBytes) + number(8, ColumnKind::kPlain) + number(9, ColumnKind::kPlain) + "</tr>";
}

std::string MoreLink(const Request& request, int64_t limit) {
  std::string place = "/sessions?";
  for (const auto& [name, value] : request.query)
    if (name != "limit") place += http::PercentEncode(name) + "=" + http::PercentEncode(value) + "&";
  return "<p>" + Link(place + "limit=" + std::to_string(std::min(limit * 4, kMostListed)), "Show more") + "</p>";
}

Result<std::string> List(Site& site, const Request& request) {
  SLX_ASSIGN_OR_RETURN(auto filter, FilterOf(request));
  SLX_ASSIGN_OR_RETURN(auto index, site.OpenIndex());
  SLX_ASSIGN_OR_RETURN(const std::string form, FilterForm(index, request));
  const int64_t limit = *filter.limit;
  filter.limit = limit + 1;
  SLX_ASSIGN_OR_RETURN(auto table, ListSessions(index, filter));
  const bool more = static_cast<int64_t>(table.rows.size()) > limit;
  if (more) table.rows.pop_back();
  std::string rows;
  for (const auto& row : table.rows) rows += RowOf(row);
  return form + "<p role=\"status\">" + (more ? "The newest " : "") + std::to_string(table.rows.size()) +
         " session(s)</p>" +
         TableFrame(
             "Sessions, newest first",
             {"picture", "session", "started", "kind", "rig", "visitor", "status", "frames", "bytes", "fits", "nrmse"},
             rows) +
         (more && limit < kMostListed ? MoreLink(request, limit) : "");
}

// A line may break behind a comma.
std::string WithBlanks(std::string list) {
  for (size_t at = 0; (at = list.find(',', at)) != std::string::npos; at += 2) list.replace(at, 1, ", ");
  return list;
}

std::string ConsentText(const Consent& consent) {
  if (consent.text_version.empty()) return "none";
  return "text " + consent.text_version + (consent.language.empty() ? "" : " (" + consent.language + ")") + ": " +
         WithBlanks(ScopeText(consent));
}

std::string FactsOf(const ServedSession& session) {
  const SessionInfo& info = session.info;
  const auto visitor = info.visitor.empty()
                           ? std::string()
                           : Link("/sessions?visitor=" + http::PercentEncode(info.visitor), info.visitor);
  const auto visit =
      info.visit.empty() ? std::string() : Link("/sessions?visit=" + http::PercentEncode(info.visit), info.visit);
  return Facts({{"Status", StatusWord(ToString(info.status))},
                {"Started", Escape(ToIso8601(info.started_wall))},
                {"Finished", info.finished_wall.ns > 0 ? Escape(ToIso8601(info.finished_wall)) : "not yet"},
                {"Kind", Escape(ToString(info.kind))},
                {"Rig", info.rig.empty() ? "" : Link("/sessions?rig=" + http::PercentEncode(info.rig), info.rig)},
                {"Visitor", visitor},
                {"Visit", visit},
                {"Attempt", info.attempt > 0 ? std::to_string(info.attempt) : ""},
                {"Consent", info.kind == SessionKind::kVisitor ? Escape(ConsentText(info.consent)) : ""},
                {"Retention", Escape(ToString(info.retention))},
                {"Encrypted", session.key_id.empty() ? "no" : "yes"},
                {"Simulated", info.simulated ? "seed " + std::to_string(info.seed) : ""},
                {"Calibration", Escape(session.calibration)},
                {"Program", Escape(info.program_version)},
                {"Frames", std::to_string(session.frames) + ", " + Escape(SizeText(session.bytes))}});
}

// Reasons, what else was found, and the shots that did not count.
std::string Findings(const SessionInfo& info) {
  std::vector<std::string> lines = info.reasons;
  for (const std::string& line : ToText(info.found.findings))
    if (std::find(info.reasons.begin(), info.reasons.end(), line) == info.reasons.end()) lines.push_back(line);
  for (const auto& [fault, shots] : info.found.faults)
    lines.push_back(std::to_string(shots) + (shots == 1 ? " shot" : " shots") + " spoilt: " + fault);
  if (lines.empty()) return "";
  std::string items;
  for (const std::string& line : lines) items += "<li>" + Escape(line) + "</li>";
  return "<h2>Findings</h2><ul class=\"findings\">" + items + "</ul>";
}

Result<std::string> Proofs(ReadOnlyIndex& index, const ServedSession& session) {
  SLX_ASSIGN_OR_RETURN(
      const auto table,
      index.Run("SELECT f.phase, CASE WHEN f.projector < 0 THEN 'all' ELSE CAST(f.projector AS TEXT) END AS projector,"
                " count(*) AS frames, sum(f.retry > 0) AS retakes, sum(f.level_check = 1) AS level_passed,"
                " sum(f.level_check = 2) AS level_failed, min(p.exposure_ms) AS shortest_ms,"
                " max(p.exposure_ms) AS longest_ms, avg(p.mean_dn) AS mean_dn"
                " FROM frames f LEFT JOIN proofs p ON p.session = f.session AND p.frame = f.frame"
                " WHERE f.session = :number GROUP BY f.phase, f.projector ORDER BY min(f.step)",
                {{"number", session.number}}));
  return "<h2>Proofs</h2>" + HtmlTable(table, "Frames by phase and projector");
}

Result<std::string> FitList(ReadOnlyIndex& index, const ServedSession& session) {
  SLX_ASSIGN_OR_RETURN(const auto table,
                       index.Run("SELECT id, created_wall_ns, nrmse, ssim, psnr_db, divergence FROM fit_overview"
                                 " WHERE session = :number ORDER BY created_wall_ns DESC, id",
                                 {{"number", session.number}}));
  std::string rows;
  for (const auto& row : table.rows) {
    const std::string id = TextOf(row[0]);
    rows += "<tr><th scope=\"row\">" + Link(SessionPlace(session.info.id) + "/fits/" + http::PercentEncode(id), id) +
            "</th><td>" + Escape(CellForPeople(row[1], ColumnKind::kWallTime)) + "</td>";
    for (size_t c = 2; c < row.size(); ++c)
      rows += "<td class=\"number\">" + Escape(CellForPeople(row[c], ColumnKind::kPlain)) + "</td>";
    rows += "</tr>";
  }
  return "<h2>Fits</h2>" +
         TableFrame("Fits, newest first", {"fit", "made", "nrmse", "ssim", "psnr db", "divergence"}, rows);
}

Response ShowSession(Site& site, const Request& request) {
  auto index = site.OpenIndex();
  if (!index.ok()) return Problem(index.status());
  const auto session = site.Find(*index, request.Wildcard("session"));
  if (!session.ok()) return Problem(session.status());
  const auto proofs = Proofs(*index, *session);
  if (!proofs.ok()) return Problem(proofs.status());
  const auto fits = FitList(*index, *session);
  if (!fits.ok()) return Problem(fits.status());
  const std::string frames =
      !session->withheld.empty()
          ? "<p class=\"problem\">Pictures and reports are not shown: " + Escape(session->withheld) + ".</p>"
      : session->frames == 0
          ? "<p>No frame was stored.</p>"
          : "<p>" + Thumbnail(session->info.id, session->frames) + "</p><p>" +
                Link(SessionPlace(session->info.id) + "/frames", "All frames with pictures") + "</p>";
  return Page("Sessions", session->info.id,
              FactsOf(*session) + Findings(session->info) + "<h2>Frames</h2>" + frames + *proofs + *fits);
}

}  // namespace

void AddSessionPages(Site& site, http::Router& router) {
  router.Add(http::Method::kGet, "/sessions", [&site](const Request& request) {
    const auto main = List(site, request);
    return main.ok() ? Page("Sessions", "Sessions", *main) : Problem(main.status());
  });
  router.Add(http::Method::kGet, "/sessions/{session}",
             [&site](const Request& request) { return ShowSession(site, request); });
}

}  // namespace stratalux::db
