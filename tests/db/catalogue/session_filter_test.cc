// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/session_filter.h"

#include <algorithm>
#include <optional>
#include <random>

#include <gtest/gtest.h>

#include "tests/db/index_rows.h"
#include "tests/db/store_fixture.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::db {
namespace {

// Newest fit's figure under its short name.
std::optional<double> FigureOf(const RowsOfSession& s, const std::string& name) {
  if (s.fits.empty()) return std::nullopt;
  const auto& fit = *std::max_element(s.fits.begin(), s.fits.end(),
                                      [](const auto& a, const auto& b) { return a.created < b.created; });
  return name == "nrmse" ? fit.nrmse : name == "ssim" ? fit.ssim : fit.divergence;
}

template <typename T>
bool OneOf(const std::vector<T>& allowed, const T& value) {
  return allowed.empty() || std::find(allowed.begin(), allowed.end(), value) != allowed.end();
}

// The oracle: the filter's sentence read aloud, row by row.
bool Passes(const RowsOfSession& s, const SessionFilter& f) {
  const SessionInfo& info = s.row.info;
  if (f.since && info.started_wall < *f.since) return false;
  if (f.until && info.started_wall >= *f.until) return false;
  if (!OneOf(f.statuses, info.status) || !OneOf(f.kinds, info.kind)) return false;
  if (!OneOf(f.rigs, info.rig) || !OneOf(f.visitors, info.visitor)) return false;
  if (!OneOf(f.visits, info.visit)) return false;
  if (f.calibration && f.calibration->empty() && !s.calibration.empty()) return false;
  if (f.calibration && !s.calibration.starts_with(*f.calibration)) return false;
  if (f.fitted != Fitted::kAny && (f.fitted == Fitted::kYes) == s.fits.empty()) return false;
  return std::all_of(f.bounds.begin(), f.bounds.end(), [&s](const FitBound& bound) {
    const auto figure = FigureOf(s, bound.metric);
    return figure && (bound.side == FitBound::Side::kAtMost ? *figure <= bound.value : *figure >= bound.value);
  });
}

class SessionFilterTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_.emplace();
    rows_ = WriteIndexRows(folder_->path(), {.sessions = 240, .frames_per_session = 3, .seed = 7});
    index_.emplace(*ReadOnlyIndex::Open(folder_->path()));
  }
  static void TearDownTestSuite() {
    index_.reset();
    folder_.reset();
  }

  static std::vector<std::string> Listed(const SessionFilter& filter) {
    const auto table = ListSessions(*index_, filter);
    EXPECT_TRUE(table.ok()) << table.status().message();
    std::vector<std::string> ids;
    if (table.ok())
      for (const auto& row : table->rows) ids.push_back(std::get<std::string>(row[0]));
    return ids;
  }
  static std::vector<std::string> Expected(const SessionFilter& filter) {
    std::vector<std::string> ids;
    for (auto s = rows_.rbegin(); s != rows_.rend(); ++s)
      if (Passes(*s, filter)) ids.push_back(s->row.info.id);
    return ids;
  }

  // Only read by the tests.
  static inline std::optional<ScratchFolder> folder_;
  static inline std::vector<RowsOfSession> rows_;
  static inline std::optional<ReadOnlyIndex> index_;
};

TEST_F(SessionFilterTest, AgreesWithReadingEveryRow) {
  std::mt19937 random(11);
  const auto below = [&random](unsigned n) { return random() % n; };
  size_t some = 0;
  for (int trial = 0; trial < 300; ++trial) {
    SessionFilter f;
    const auto any = [&]() -> const RowsOfSession& { return rows_[below(static_cast<unsigned>(rows_.size()))]; };
    if (below(3) == 0) f.since = any().row.info.started_wall;
    if (below(3) == 0) f.until = any().row.info.started_wall;
    if (below(3) == 0) f.statuses = {any().row.info.status, any().row.info.status};
    if (below(4) == 0) f.kinds = {any().row.info.kind};
    if (below(3) == 0) f.rigs = {any().row.info.rig, any().row.info.rig};
    if (below(8) == 0) f.visitors = {any().row.info.visitor, any().row.info.visitor};
    if (below(8) == 0) f.visits = {any().row.info.visit, any().row.info.visit};
    if (below(4) == 0) f.calibration = any().calibration.substr(0, below(6));
    if (below(3) == 0) f.fitted = below(2) == 0 ? Fitted::kYes : Fitted::kNo;
    if (below(3) == 0) f.bounds.push_back({"nrmse", FitBound::Side::kAtMost, static_cast<int>(below(1000)) / 1000.0});
    if (below(3) == 0)
      f.bounds.push_back({"divergence", FitBound::Side::kAtLeast, static_cast<int>(below(1000)) / 1000.0});
    const auto expected = Expected(f);
    ASSERT_EQ(Listed(f), expected) << "trial " << trial << QueryOf(f).sql;
    some += !expected.empty() && expected.size() < rows_.size() ? 1 : 0;
  }
  EXPECT_GT(some, 100U) << "filters that let everything or nothing pass prove little";
}

TEST_F(SessionFilterTest, SortsByEachKeyAndCutsAtTheLimit) {
  SessionFilter f;
  f.sort = SortKey::kFrames;
  f.limit = 50;
  const auto table = ListSessions(*index_, f);
  ASSERT_TRUE(table.ok());
  ASSERT_EQ(table->rows.size(), 50U);
  auto frames = rows_;
  std::stable_sort(frames.begin(), frames.end(),
                   [](const auto& a, const auto& b) { return a.row.frames > b.row.frames; });
  for (size_t i = 0; i < 50; ++i) EXPECT_EQ(std::get<int64_t>(table->rows[i][6]), frames[i].row.frames);

  f = {};
  f.sort = SortKey::kNrmse;
  f.order = SortOrder::kAscending;
  const auto ids = Listed(f);
  std::vector<double> figures;
  size_t unfitted = 0;
  for (const std::string& id : ids) {
    const auto s = std::find_if(rows_.begin(), rows_.end(), [&](const auto& r) { return r.row.info.id == id; });
    const auto figure = FigureOf(*s, "nrmse");
    if (!figure) ++unfitted;
    if (figure) {
      EXPECT_EQ(unfitted, 0U) << "sessions without the figure come last";
      figures.push_back(*figure);
    }
  }
  EXPECT_TRUE(std::is_sorted(figures.begin(), figures.end()));
  EXPECT_EQ(ids.size(), rows_.size());
}

TEST_F(SessionFilterTest, ShowsTheCalibrationsAgeAtTheStart) {
  const auto table = ListSessions(*index_, {});
  ASSERT_TRUE(table.ok());
  for (size_t i = 0; i < rows_.size(); ++i) {
    const RowsOfSession& s = rows_[rows_.size() - 1 - i];
    const Cell& age = table->rows[i][10];
    ASSERT_EQ(std::holds_alternative<double>(age), !s.calibration.empty());
    if (s.calibration.empty()) continue;
    const auto expected = static_cast<double>(s.row.info.started_wall.ns - s.calibration_since.ns) / 86400e9;
    EXPECT_NEAR(std::get<double>(age), expected, 1e-9);
  }
}

TEST_F(SessionFilterTest, TakesHostileValuesAsValues) {
  SessionFilter f;
  f.rigs = {"' OR 1=1 --", "\"; DROP TABLE sessions", "%"};
  EXPECT_TRUE(Listed(f).empty());
  f = {};
  f.calibration = "%";
  EXPECT_TRUE(Listed(f).empty());
  f = {};
  f.bounds = {{"x' OR '1'='1", FitBound::Side::kAtLeast, -1.0}};
  EXPECT_TRUE(Listed(f).empty());
  EXPECT_EQ(Listed({}).size(), rows_.size());
}

}  // namespace
}  // namespace stratalux::db
