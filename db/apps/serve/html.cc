// SPDX-License-Identifier: Apache-2.0
#include "db/apps/serve/html.h"

#include <algorithm>

#include "db/apps/display_text.h"
#include "db/apps/table_output.h"
#include "shared/http/target.h"

namespace stratalux::db {
namespace {

struct Section {
  const char *name, *place;
};
constexpr Section kSections[] = {{"Overview", "/"},
                                 {"Sessions", "/sessions"},
                                 {"Questions", "/queries"},
                                 {"Consent", "/consent"},
                                 {"Deletions", "/deletions"}};

bool IsNumber(const Cell& cell, ColumnKind kind) {
  return kind != ColumnKind::kWallTime &&
         (std::holds_alternative<int64_t>(cell) || std::holds_alternative<double>(cell));
}

std::string CellMarkup(const Cell& cell, const Column& column) {
  const auto* text = std::get_if<std::string>(&cell);
  if (text != nullptr && column.name == "session" && !text->empty()) return Link(SessionPlace(*text), *text);
  if (text != nullptr && column.name == "status") return StatusWord(*text);
  return Escape(CellForPeople(cell, column.kind));
}

std::string Words(std::string name) {
  std::replace(name.begin(), name.end(), '_', ' ');
  return name;
}

std::string Navigation(const std::string& current) {
  std::string items;
  for (const Section& section : kSections)
    items += std::string("<li><a href=\"") + section.place + "\"" +
             (current == section.name ? " aria-current=\"page\"" : "") + ">" + section.name + "</a></li>";
  return "<nav aria-label=\"Store\"><ul>" + items + "</ul></nav>";
}

int HttpStatus(StatusCode code) {
  switch (code) {
    case StatusCode::kNotFound:
      return 404;
    case StatusCode::kUsage:
      return 400;
    case StatusCode::kBusy:
    case StatusCode::kTryAgain:
      return 503;
    default:
      return 500;
  }
}

}  // namespace

std::string Escape(std::string_view text) {
  std::string escaped;
  for (const char c : Printable(text)) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      case '\'':
        escaped += "&#39;";
        break;
      default:
        escaped += c;
    }
  }
  return escaped;
}

std::string Link(const std::string& place, std::string_view text) {
  return "<a href=\"" + Escape(place) + "\">" + Escape(text) + "</a>";
}

std::string SessionPlace(std::string_view id) { return "/sessions/" + http::PercentEncode(id); }

std::string StatusWord(std::string_view status) {
  constexpr std::string_view kKnown[] = {"complete", "degraded", "failed", "recording"};
  const bool known = std::find(std::begin(kKnown), std::end(kKnown), status) != std::end(kKnown);
  return "<span class=\"status" + (known ? " " + std::string(status) : "") + "\">" + Escape(status) + "</span>";
}

std::string TableFrame(const std::string& caption, const std::vector<std::string>& headers, const std::string& rows) {
  std::string head;
  for (const std::string& header : headers) head += "<th scope=\"col\">" + Escape(header) + "</th>";
  const std::string none = "<tr><td colspan=\"" + std::to_string(headers.size()) + "\">none</td></tr>";
  return "<div class=\"scroll\" role=\"region\" tabindex=\"0\" aria-label=\"" + Escape(caption) +
         "\"><table><caption>" + Escape(caption) + "</caption><thead><tr>" + head + "</tr></thead><tbody>" +
         (rows.empty() ? none : rows) + "</tbody></table></div>";
}

std::string HtmlTable(const ResultTable& table, const std::string& caption) {
  std::vector<std::string> headers;
  for (const Column& column : table.columns)
    if (column.place == ColumnPlace::kEverywhere) headers.push_back(Words(column.name));
  std::string rows;
  for (const auto& row : table.rows) {
    rows += "<tr>";
    for (size_t c = 0; c < row.size(); ++c) {
      const Column& column = table.columns[c];
      if (column.place != ColumnPlace::kEverywhere) continue;
      rows += (IsNumber(row[c], column.kind) ? "<td class=\"number\">" : "<td>") + CellMarkup(row[c], column) + "</td>";
    }
    rows += "</tr>";
  }
  const std::string more = table.truncated ? "<p class=\"note\">There are more rows than these.</p>" : "";
  return TableFrame(caption, headers, rows) + more;
}

std::string Facts(const std::vector<std::pair<std::string, std::string>>& facts) {
  std::string list;
  for (const auto& [name, value] : facts)
    if (!value.empty()) list += "<div><dt>" + Escape(name) + "</dt><dd>" + value + "</dd></div>";
  return "<dl>" + list + "</dl>";
}

http::Response Page(const std::string& section, const std::string& title, const std::string& main, int status) {
  const std::string text =
      "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + Escape(title) +
      " - Stratalux store</title><meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">"
      "<meta name=\"color-scheme\" content=\"light dark\"><link rel=\"icon\" href=\"/icon.svg\">"
      "<link rel=\"stylesheet\" href=\"/style.css\"></head><body>"
      "<a class=\"skip\" href=\"#main\">Skip to the content</a><header><p class=\"name\">Stratalux store</p>" +
      Navigation(section) + "</header><main id=\"main\" tabindex=\"-1\"><h1>" + Escape(title) + "</h1>" + main +
      "</main><footer><p>Read-only. Viewing pictures and reports is recorded in the access log.</p></footer>"
      "</body></html>\n";
  return http::Response::Of("text/html; charset=utf-8", text, status);
}

http::Response Problem(const Status& status) {
  const int code = HttpStatus(status.code());
  const char* title = code == 404 ? "Not here" : code == 400 ? "Not understood" : code == 503 ? "Busy" : "This failed";
  return Page("", title, "<p class=\"problem\">" + Escape(status.message()) + "</p>", code);
}

}  // namespace stratalux::db
