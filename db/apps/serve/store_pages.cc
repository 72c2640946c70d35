// SPDX-License-Identifier: Apache-2.0
// Overview, consent and retention, deletions.
#include <filesystem>

#include <nlohmann/json.hpp>

#include "db/apps/display_text.h"
#include "db/apps/serve/html.h"
#include "db/apps/serve/site.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/named_query.h"
#include "db/catalogue/schema_check.h"
#include "db/privacy/retention.h"

namespace stratalux::db {
namespace {

using http::Request;
using http::Response;
using SortedJson = nlohmann::json;

constexpr int64_t kNights = 14;

Result<ResultTable> Ask(ReadOnlyIndex& index, const std::string& name, int64_t limit) {
  SLX_ASSIGN_OR_RETURN(const auto* query, FindQuery(name));
  return RunQuery(index, *query, {{"now_ns", WallNow().ns}, {"limit", limit}});
}

std::string SpaceText(const std::filesystem::path& store) {
  std::error_code error;
  const auto space = std::filesystem::space(store, error);
  return error ? "unknown: " + Escape(error.message())
               : Escape(SizeText(static_cast<int64_t>(space.available)) + " of " +
                        SizeText(static_cast<int64_t>(space.capacity)));
}

std::string Counted(int64_t count, const std::string& place) { return Link(place, std::to_string(count)); }

Result<std::string> Counts(ReadOnlyIndex& index, const std::filesystem::path& store) {
  SLX_ASSIGN_OR_RETURN(
      const auto table,
      index.Run("SELECT count(*), coalesce(sum(status = 'complete'), 0), coalesce(sum(status = 'degraded'), 0),"
                " coalesce(sum(status = 'failed'), 0), coalesce(sum(status = 'recording'), 0),"
                " coalesce(sum(frame_count), 0), coalesce(sum(stored_bytes), 0), (SELECT count(*) FROM fits),"
                " (SELECT count(*) FROM visitors) FROM sessions"));
  const auto& row = table.rows.front();
  const auto status = [&row](size_t column, const std::string& name) {
    return Counted(IntegerOf(row[column]), "/sessions?status=" + name);
  };
  return Facts({{"Sessions", Counted(IntegerOf(row[0]), "/sessions")},
                {"Complete", status(1, "complete")},
                {"Degraded", status(2, "degraded")},
                {"Failed", status(3, "failed")},
                {"Recording", status(4, "recording")},
                {"Visitors", std::to_string(IntegerOf(row[8]))},
                {"Frames", std::to_string(IntegerOf(row[5]))},
                {"Payloads", Escape(SizeText(IntegerOf(row[6])))},
                {"Fits", std::to_string(IntegerOf(row[7]))},
                {"Free on the disk", SpaceText(store)}});
}

// What opening the store would mend, and what waits for somebody.
Result<std::string> Notes(Site& site, ReadOnlyIndex& index) {
  std::string items;
  SLX_ASSIGN_OR_RETURN(const auto opened, SessionStore::Open(site.store(), AccessMode::kReadOnly));
  for (const std::string& note : opened.notes()) items += "<li>" + Escape(note) + "</li>";
  SLX_ASSIGN_OR_RETURN(const auto due, Ask(index, "retention-due", int64_t{1000}));
  if (!due.rows.empty())
    items += "<li>" + std::to_string(due.rows.size()) +
             " session(s) past their retention: " + Link("/consent", "consent and retention") + "</li>";
  return "<h2>Notes</h2>" +
         (items.empty() ? "<p>Nothing needs attention.</p>" : "<ul class=\"notes\">" + items + "</ul>");
}

Result<std::string> Overview(Site& site) {
  SLX_ASSIGN_OR_RETURN(auto index, site.OpenIndex());
  SLX_ASSIGN_OR_RETURN(const std::string counts, Counts(index, site.store()));
  SLX_ASSIGN_OR_RETURN(const std::string notes, Notes(site, index));
  SLX_ASSIGN_OR_RETURN(const auto days, Ask(index, "sessions-per-day", kNights));
  SLX_ASSIGN_OR_RETURN(const auto night, Ask(index, "last-night", int64_t{50}));
  return "<p>" + Escape(site.store().string()) + "</p>" + counts + notes + "<h2>Last night</h2>" +
         HtmlTable(night, "Sessions from noon to noon") + "<h2>Last days</h2>" + HtmlTable(days, "Sessions a day");
}

ResultTable TableOf(const std::vector<ConsentRow>& consents) {
  ResultTable table;
  table.columns = {{"visitor"},
                   {"text"},
                   {"language"},
                   {"scope"},
                   {"given", ColumnKind::kWallTime},
                   {"withdrawn", ColumnKind::kWallTime}};
  for (const ConsentRow& row : consents)
    table.rows.push_back({row.visitor, row.consent.text_version, row.consent.language, ScopeText(row.consent),
                          row.consent.given_wall.ns, row.withdrawn ? Cell(row.withdrawn->ns) : Cell()});
  return table;
}

Result<std::string> ConsentAndRetention(Site& site) {
  SLX_RETURN_IF_ERROR(RequireCurrentSchema(site.store()));
  SLX_ASSIGN_OR_RETURN(auto index, site.OpenIndex());
  SLX_ASSIGN_OR_RETURN(const auto due, Ask(index, "retention-due", int64_t{1000}));
  SLX_ASSIGN_OR_RETURN(const auto missing, Ask(index, "consent-missing", int64_t{1000}));
  SLX_ASSIGN_OR_RETURN(const auto consents, ListConsents(site.store(), ""));
  const RetentionDays days;
  return "<h2>Due</h2><p>Visitors' sessions that are older than their class allows (short " +
         std::to_string(days.short_days) + ", standard " + std::to_string(days.standard_days) + ", long " +
         std::to_string(days.long_days) +
         " days), or whose consent was withdrawn. <code>stratalux-db purge</code> forgets them; a rig's configuration "
         "may"
         " set other days.</p>" +
         HtmlTable(due, "Sessions that are due") + "<h2>Without consent</h2>" +
         HtmlTable(missing, "Visitors' sessions that no consent covers") + "<h2>Consents</h2>" +
         HtmlTable(TableOf(consents), "Consents, oldest first");
}

template <typename T>
T ValueOf(const SortedJson& object, const char* name, T otherwise) {
  const auto found = object.is_object() ? object.find(name) : object.end();
  if (!object.is_object() || found == object.end()) return otherwise;
  const bool fits = std::is_same_v<T, std::string> ? found->is_string()
                    : std::is_same_v<T, bool>      ? found->is_boolean()
                                                   : found->is_number();
  return fits ? found->get<T>() : otherwise;
}

Result<std::string> DeletionsPage(Site& site) {
  SLX_RETURN_IF_ERROR(RequireCurrentSchema(site.store()));
  SLX_ASSIGN_OR_RETURN(const auto deletions, ListDeletions(site.store()));
  ResultTable table;
  table.columns = {{"forgotten"}, {"deleted"}, {"reason"}, {"by"}, {"frames"}, {"nothing left"}, {"files read"}};
  for (const Deletion& deletion : deletions) {
    const SortedJson json = SortedJson::parse(deletion.certificate_json, nullptr, false);
    const SortedJson proof = json.is_object() && json.contains("verification") ? json["verification"] : SortedJson();
    table.rows.push_back(
        {deletion.session, ValueOf<std::string>(json, "deleted", "?"), ValueOf<std::string>(json, "reason", "?"),
         ValueOf<std::string>(json, "by", "?"), ValueOf<int64_t>(json, "frames", 0),
         std::string(ValueOf<bool>(proof, "clean", false) ? "yes" : "NO"), ValueOf<int64_t>(proof, "files_read", 0)});
  }
  return "<p>What was forgotten, and what the search for its traces found. Nothing of a forgotten session can be"
         " shown.</p>" +
         HtmlTable(table, "Certificates of deletion");
}

Response Show(const std::string& section, const std::string& title, const Result<std::string>& main) {
  return main.ok() ? Page(section, title, *main) : Problem(main.status());
}

}  // namespace

void AddStorePages(Site& site, http::Router& router) {
  router.Add(http::Method::kGet, "/", [&site](const Request&) { return Show("Overview", "Overview", Overview(site)); });
  router.Add(http::Method::kGet, "/consent",
             [&site](const Request&) { return Show("Consent", "Consent and retention", ConsentAndRetention(site)); });
  router.Add(http::Method::kGet, "/deletions",
             [&site](const Request&) { return Show("Deletions", "Deletions", DeletionsPage(site)); });
}

}  // namespace stratalux::db
