// SPDX-License-Identifier: Apache-2.0
// The index's rows against those that a rebuild yields, column by column over the schema's own list of columns, so that
// a column which comes later is compared without a word here. What cannot be rebuilt is listed with its reason.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/catalogue/session_index.h"

namespace stratalux::db {

struct TableRule {
  enum class Extent {
    kSame,           // both have the same rows
    kIndexHasMore,   // rows of other sessions, and what visitors said when no session was made
    kRebuildHasMore  // a live writer's frames may be in its segment before they are in the index
  };
  const char* table;
  const char* rows;      // SQL: which rows belong to the session with number ?1
  const char* key;       // columns that name a row, joined by commas
  const char* left_out;  // columns that are not compared, joined by commas
  const char* reason;    // why those; "" where there are none
  Extent extent = Extent::kSame;
};

// Every table of the schema is in one of the two lists: a test holds that.
[[nodiscard]] const std::vector<TableRule>& SessionTables();
struct StoreTable {
  const char* table;
  const char* reason;  // why no session's files tell its rows
};
[[nodiscard]] const std::vector<StoreTable>& StoreTables();

// What differs, one line each: file, table.column, row, both values; at most 5 lines a table. `number` is the
// session's in both indexes.
[[nodiscard]] Result<std::vector<std::string>> CompareRows(Connection& index, Connection& rebuilt,
                                                           const TableRule& rule, int64_t number,
                                                           const std::string& file);

// Tables, views, indexes and triggers that are not those of the schema.
[[nodiscard]] Result<std::vector<std::string>> CompareSchemas(Connection& index, const std::string& file);

// All of a session's tables. `folder`: sessions/<id>.
// `notes`: fits that lie there whole and unlisted.
[[nodiscard]] std::vector<std::string> CompareSession(const std::filesystem::path& store, const SessionRow& session,
                                                      std::vector<std::string>& notes);

// What belongs to no session's files: deletions against their certificates, the numbers given, whose records the
// calibrations are.
[[nodiscard]] Result<std::vector<std::string>> CompareStore(const std::filesystem::path& store);

}  // namespace stratalux::db
