// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/named_query.h"

#include <algorithm>
#include <sstream>

#include "db/queries.h"
#include "shared/base/nearest.h"

namespace stratalux::db {
namespace {

Result<ColumnKind> KindOf(const std::string& word) {
  if (word == "text" || word == "number") return ColumnKind::kPlain;
  if (word == "time") return ColumnKind::kWallTime;
  if (word == "bytes") return ColumnKind::kBytes;
  if (word == "days") return ColumnKind::kDays;
  return Status::Failed("column kind '" + word + "' is unknown; allowed: text, number, time, bytes, days");
}

std::string Rest(std::istringstream& line) {
  std::string rest;
  std::getline(line >> std::ws, rest);
  return rest;
}

// A line of the head, without its "-- ".
Status ParseHeadLine(const std::string& text, NamedQuery& query) {
  std::istringstream line(text);
  std::string word;
  line >> word;
  if (word == query.name + ":") {
    query.question = Rest(line);
  } else if (word == "parameters:") {
    while (line >> word) query.parameters.push_back(word);
  } else if (word == "column") {
    QueryColumn column;
    line >> column.name >> column.kind;
    column.meaning = Rest(line);
    SLX_RETURN_IF_ERROR(KindOf(column.kind).status());
    query.columns.push_back(column);
  } else {
    query.notes += (query.notes.empty() ? "" : " ") + text;
  }
  return Status::Ok();
}

std::vector<NamedQuery> ParseAll() {
  std::vector<NamedQuery> queries;
  for (const QuerySource& source : kQuerySources) {
    auto query = ParseQuery(source.name, source.text);
    // A head that does not parse is found by the tests; its query then answers without column kinds.
    queries.push_back(query.ok() ? std::move(query).value()
                                 : NamedQuery{source.name, query.status().message(), {}, {}, {}, source.text});
  }
  std::sort(queries.begin(), queries.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  return queries;
}

}  // namespace

Result<NamedQuery> ParseQuery(const std::string& name, const std::string& text) {
  NamedQuery query;
  query.name = name;
  query.sql = text;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line) && line.starts_with("--");)
    SLX_RETURN_IF_ERROR(
        ParseHeadLine(line.substr(std::min<size_t>(3, line.size())), query).WithContext("query " + name));
  if (query.question.empty()) return Status::Failed("query " + name + ": its head must start with '-- " + name + ": '");
  if (query.columns.empty()) return Status::Failed("query " + name + ": its head names no column");
  return query;
}

const std::vector<NamedQuery>& NamedQueries() {
  static const std::vector<NamedQuery> queries = ParseAll();
  return queries;
}

Result<const NamedQuery*> FindQuery(const std::string& name) {
  std::vector<std::string> names;
  for (const NamedQuery& query : NamedQueries()) {
    if (query.name == name) return &query;
    names.push_back(query.name);
  }
  return Status::NotFound(UnknownName("query", name, names));
}

Result<ResultTable> RunQuery(ReadOnlyIndex& index, const NamedQuery& query, const QueryParameters& parameters,
                             const QueryLimits& limits) {
  SLX_ASSIGN_OR_RETURN(auto table, index.Run(query.sql, parameters, limits).WithContext("query " + query.name));
  if (table.columns.size() != query.columns.size())
    return Status::Failed("query " + query.name + ": its head names " + std::to_string(query.columns.size()) +
                          " columns, it gives " + std::to_string(table.columns.size()));
  for (size_t c = 0; c < table.columns.size(); ++c) {
    if (table.columns[c].name != query.columns[c].name)
      return Status::Failed("query " + query.name + ": column " + table.columns[c].name + " is not the head's " +
                            query.columns[c].name);
    SLX_ASSIGN_OR_RETURN(table.columns[c].kind, KindOf(query.columns[c].kind));
  }
  return table;
}

}  // namespace stratalux::db
