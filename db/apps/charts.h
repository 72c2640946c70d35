// SPDX-License-Identifier: Apache-2.0
// Small charts for the terminal, and one page of them for a browser.
#pragma once

#include <string>

#include "db/apps/statistics.h"

namespace stratalux::db {

enum class Glyphs { kBlocks, kAscii };  // block elements of Unicode, or # and :

// One column a point, `rows` lines high, with the largest value at the top left and the first and last label below. The
// scale starts at 0. A value above 0 is never drawn as nothing; a point without a value is left blank.
[[nodiscard]] std::string ColumnChart(const Series& series, Glyphs glyphs, int rows = 5);
// One line a point: label, bar, value.
[[nodiscard]] std::string BarChart(const Series& series, Glyphs glyphs, int width = 30);
[[nodiscard]] std::string StatisticsAsText(const Statistics& statistics, Glyphs glyphs);
// One self-contained page: inline SVG, no script, nothing loaded from elsewhere; follows the reader's light or dark.
[[nodiscard]] std::string StatisticsAsHtml(const Statistics& statistics, const std::string& store);

}  // namespace stratalux::db
