// SPDX-License-Identifier: Apache-2.0
// The questions operators ask by name: db/catalogue/queries/NAME.sql, embedded. The head of each file is its
// documentation and is read here, so that help, output and text cannot part:
//
//   -- NAME: the question it answers
//   -- more about it                                   (any number of lines)
//   -- parameters: since until rig limit               (which of them it knows)
//   -- column NAME KIND meaning, unit                  (one a column, in order; KIND: text number time bytes days)
#pragma once

#include <span>
#include <string>
#include <vector>

#include "db/catalogue/read_only_index.h"

namespace stratalux::db {

struct QueryColumn {
  std::string name, kind, meaning;
};

struct NamedQuery {
  std::string name;
  std::string question;
  std::string notes;                    // may be empty
  std::vector<std::string> parameters;  // of: since, until, rig, limit
  std::vector<QueryColumn> columns;
  std::string sql;
};

// By name. Parsed once.
[[nodiscard]] const std::vector<NamedQuery>& NamedQueries();
// kNotFound: says which one was meant, or which there are.
[[nodiscard]] Result<const NamedQuery*> FindQuery(const std::string& name);
// kFailed: the head is not as above.
[[nodiscard]] Result<NamedQuery> ParseQuery(const std::string& name, const std::string& text);

// Columns carry the kinds of the head. `parameters`: since_ns, until_ns, now_ns (integers), rig, limit; absent ones are
// NULL, which a query takes as "all". kFailed: the result's columns are not those of the head.
Result<ResultTable> RunQuery(ReadOnlyIndex& index, const NamedQuery& query, const QueryParameters& parameters,
                             const QueryLimits& limits = {});

}  // namespace stratalux::db
