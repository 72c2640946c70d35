// SPDX-License-Identifier: Apache-2.0
// Named queries, with the parameters each one knows.
#include <charconv>

#include "db/apps/moment.h"
#include "db/apps/serve/html.h"
#include "db/apps/serve/site.h"
#include "db/catalogue/named_query.h"
#include "shared/capture/finding.h"

namespace stratalux::db {
namespace {

using http::Request;
using http::Response;

constexpr int64_t kMostRows = 1000;

Response ListQueries() {
  std::string items;
  for (const NamedQuery& query : NamedQueries())
    items +=
        "<li>" + Link("/queries/" + query.name, query.question) + " <small>" + Escape(query.name) + "</small></li>";
  return Page("Questions", "Questions", "<ul class=\"questions\">" + items + "</ul>");
}

Result<QueryParameters> ParametersOf(const NamedQuery& query, const Request& request) {
  const WallNs now = WallNow();
  QueryParameters parameters{{"now_ns", now.ns}, {"limit", kMostRows}};
  for (const std::string& name : query.parameters) {
    const std::string text = request.Query(name);
    if (text.empty()) continue;
    if (name == "rig" || name == "kind") parameters[name] = text;
    if (name == "kind" && !ParseFindingKind(text).ok())
      return Status::Usage("kind '" + text + "' is not a kind of finding, such as moved, lamp, no-proof");
    if (name == "since" || name == "until") {
      SLX_ASSIGN_OR_RETURN(const WallNs moment, ParseMoment(text, now).WithContext(name));
      parameters[name + "_ns"] = moment.ns;
    }
    if (name != "limit") continue;
    int64_t limit = 0;
    const auto end = std::from_chars(text.data(), text.data() + text.size(), limit);
    if (end.ptr != text.data() + text.size() || limit < 1 || limit > kMostRows)
      return Status::Usage("limit must be a number from 1 to " + std::to_string(kMostRows));
    parameters["limit"] = limit;
  }
  return parameters;
}

std::string Form(const NamedQuery& query, const Request& request) {
  std::string inputs;
  for (const std::string& name : query.parameters) {
    const char* hint = name == "rig"     ? "name"
                       : name == "kind"  ? "such as moved"
                       : name == "limit" ? "rows"
                                         : "7d or 2026-11-21";
    inputs += "<p><label for=\"" + Escape(name) + "\">" + Escape(name) + "</label><input id=\"" + Escape(name) +
              "\" name=\"" + Escape(name) + "\" value=\"" + Escape(request.Query(name)) + "\" placeholder=\"" + hint +
              "\"></p>";
  }
  if (inputs.empty()) return "";
  return "<form method=\"get\" role=\"search\" aria-label=\"Parameters\">" + inputs +
         "<p class=\"buttons\"><button type=\"submit\">Ask</button></p></form>";
}

std::string Meanings(const NamedQuery& query) {
  std::vector<std::pair<std::string, std::string>> facts;
  for (const QueryColumn& column : query.columns) facts.emplace_back(column.name, Escape(column.meaning));
  return "<details><summary>What the columns mean</summary>" + Facts(facts) + "</details>";
}

Result<std::string> Answer(Site& site, const NamedQuery& query, const Request& request) {
  SLX_ASSIGN_OR_RETURN(const auto parameters, ParametersOf(query, request));
  SLX_ASSIGN_OR_RETURN(auto index, site.OpenIndex());
  SLX_ASSIGN_OR_RETURN(const auto table, RunQuery(index, query, parameters));
  return "<p>" + Escape(query.notes) + "</p>" + Form(query, request) + HtmlTable(table, query.question) +
         Meanings(query);
}

Response ShowQuery(Site& site, const Request& request) {
  const auto query = FindQuery(request.Wildcard("query"));
  if (!query.ok()) return Problem(query.status());
  const auto main = Answer(site, **query, request);
  return main.ok() ? Page("Questions", (*query)->question, *main) : Problem(main.status());
}

}  // namespace

void AddQueryPages(Site& site, http::Router& router) {
  router.Add(http::Method::kGet, "/queries", [](const Request&) { return ListQueries(); });
  router.Add(http::Method::kGet, "/queries/{query}",
             [&site](const Request& request) { return ShowQuery(site, request); });
}

}  // namespace stratalux::db
