// SPDX-License-Identifier: Apache-2.0
// The answer to a query: named columns, typed cells.
#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

namespace stratalux::db {

using Blob = std::vector<uint8_t>;
// monostate: SQL's NULL. Text is bytes as stored: UTF-8 by intention, not by guarantee.
using Cell = std::variant<std::monostate, int64_t, double, std::string, Blob>;

// What the numbers of a column mean; a renderer's hint, never needed to read the cell.
enum class ColumnKind {
  kPlain,
  kWallTime,  // ns since 1970 UTC; shown as 2026-11-21T04:06:11Z
  kBytes,     // shown as 1.5 GiB to people
  kDays,      // shown with one decimal to people
  kBoolean,   // 0 | 1
  kJson,      // JSON text; nested in JSON output
};
// kDetail: only where there is room (JSON, CSV), not in the table for people.
enum class ColumnPlace { kEverywhere, kDetail };

struct Column {
  std::string name;
  ColumnKind kind = ColumnKind::kPlain;
  ColumnPlace place = ColumnPlace::kEverywhere;
};

struct ResultTable {
  std::vector<Column> columns;
  std::vector<std::vector<Cell>> rows;  // each as long as `columns`
  bool truncated = false;               // a limit ended it; there was at least one more row
};

}  // namespace stratalux::db
