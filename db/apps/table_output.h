// SPDX-License-Identifier: Apache-2.0
// One renderer for every table that `stratalux-db` prints.
#pragma once

#include <string>

#include "db/catalogue/result_table.h"

namespace stratalux::db {

// One cell of that table.
[[nodiscard]] std::string CellForPeople(const Cell& cell, ColumnKind kind);
// For people: columns aligned by what a terminal shows, numbers to the right, nothing that steers the terminal, sizes
// as "1.5 GiB", times as ISO 8601, six digits of a real number; '-' for NULL, "(none)" below a table without rows.
// Detail columns are left out.
[[nodiscard]] std::string TableAsText(const ResultTable& table);
// An array of objects in the order of the columns: integers, reals, texts, null; times as ISO 8601, truth values as
// such, blobs as lower-case hex. Bytes that are no UTF-8 become U+FFFD, numbers that are not finite null. Of columns of
// one name the second is called name_2.
[[nodiscard]] std::string TableAsJson(const ResultTable& table);
// RFC 4180 with a header line: CRLF, quotes where needed and doubled inside. Text as it is, byte by byte; NULL is
// empty, an empty text is "". Times, blobs as in JSON; reals with all their digits.
[[nodiscard]] std::string TableAsCsv(const ResultTable& table);

}  // namespace stratalux::db
