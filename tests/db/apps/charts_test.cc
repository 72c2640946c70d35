// SPDX-License-Identifier: Apache-2.0
#include "db/apps/charts.h"

#include <algorithm>

#include <gmock/gmock.h>

#include "db/apps/display_text.h"
#include "tests/db/index_rows.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(Charts, ColumnsStandInProportion) {
  const Series series{
      "T", Series::Unit::kCount, {{"2026-01-01", 8.0}, {"b", 4.0}, {"c", 0.0}, {"d", {}}, {"e", 0.001}}};
  EXPECT_EQ(ColumnChart(series, Glyphs::kBlocks, 2),
            "T\n"
            "  8 \u2588\n"
            "  0 \u2588\u2588  \u2581\n"
            "    2026-01-01 ... e\n")
      << "something is never drawn as nothing";
  EXPECT_EQ(ColumnChart(series, Glyphs::kAscii, 2), "T\n  8 #\n  0 ##  :\n    2026-01-01 ... e\n");
}

TEST(Charts, BarsStandInProportionAndAlign) {
  const Series series{"T", Series::Unit::kBytes, {{"long name", 2048.0}, {"b", 1024.0}}};
  EXPECT_EQ(BarChart(series, Glyphs::kAscii, 4), "T\n  long name  #### 2.0 KiB\n  b          ## 1.0 KiB\n");
  EXPECT_THAT(BarChart({"T", Series::Unit::kCount, {}}, Glyphs::kAscii), HasSubstr("nothing to show"));
}

class StatisticsTest : public StoreTest {};

TEST_F(StatisticsTest, AddUpToTheRows) {
  std::filesystem::remove_all(folder_);
  std::filesystem::create_directory(folder_);
  const IndexRowsOptions options{.sessions = 90, .frames_per_session = 4, .seed = 5};
  const auto rows = WriteIndexRows(folder_, options);
  auto index = *ReadOnlyIndex::Open(folder_);
  for (const int64_t days : {5, 29, 200}) {
    const auto s = LoadStatistics(index, {options.now.ns - days * 86'400'000'000'000}, options.now);
    ASSERT_TRUE(s.ok()) << s.status().message();
    int64_t sessions = 0, complete = 0, bytes = 0, all_bytes = 0;
    for (const RowsOfSession& row : rows) {
      all_bytes += row.row.bytes;
      if (row.row.info.started_wall < s->since) continue;
      ++sessions;
      complete += row.row.info.status == SessionStatus::kComplete ? 1 : 0;
      bytes += row.row.bytes;
    }
    EXPECT_EQ(s->sessions, sessions);
    EXPECT_EQ(s->complete, complete);
    EXPECT_EQ(s->bytes, bytes);
    double in_bins = 0.0, not_complete = 0.0;
    for (const auto& point : s->sessions_per_bin.points) in_bins += *point.value;
    for (const auto& point : s->not_complete_per_bin.points) not_complete += *point.value;
    EXPECT_EQ(in_bins, sessions);
    EXPECT_EQ(not_complete, sessions - complete);
    EXPECT_EQ(*s->disk.points.back().value, all_bytes) << "what was there before the span still takes space";
    EXPECT_LE(s->disk.points.size(), static_cast<size_t>(kMostBins));
    EXPECT_EQ(s->days_per_bin, days < kMostBins ? 1 : 4);
  }
  EXPECT_EQ(LoadStatistics(index, {10}, {5}).status().code(), StatusCode::kUsage);
}

TEST_F(StatisticsTest, ThePageLoadsNothingAndKeepsHostileTextHarmless) {
  Statistics s;
  s.failures = {"Why", Series::Unit::kCount, {{"<script>alert(1)</script> & \"x\"", 1.0}}};
  s.sessions_per_bin = {"Sessions", Series::Unit::kCount, {{"2026-01-01", 1.0}}};
  const std::string page = StatisticsAsHtml(s, "<b>store\n");
  EXPECT_THAT(page, Not(HasSubstr("<script")));
  EXPECT_THAT(page, Not(HasSubstr("<b>store")));
  EXPECT_THAT(page, Not(HasSubstr("http")));
  EXPECT_THAT(page, HasSubstr("&lt;script&gt;alert(1)&lt;/script&gt; &amp; &quot;x&quot;"));
  EXPECT_EQ(page.find("src="), std::string::npos);
}

}  // namespace
}  // namespace stratalux::db
