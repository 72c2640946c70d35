// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/selfcheck_trend.h"

#include <cmath>
#include <cstdlib>
#include <ctime>
#include <random>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using Json = nlohmann::json;

constexpr int64_t kDayNs = 24LL * 3600 * 1'000'000'000;
const WallNs kFirst{1795507200'000'000'000};  // 2026-11-24T08:00:00Z

class SelfcheckTrendTest : public ::testing::Test {
 protected:
  SelfcheckTrendTest() {
    setenv("TZ", "UTC0", 1);
    tzset();
  }
  // Of day `day`, with these levels of two projectors.
  static Selfcheck Check(double day, double level0, double level1 = 500.0) {
    Selfcheck check;
    check.at = {kFirst.ns + static_cast<int64_t>(day * static_cast<double>(kDayNs))};
    check.passed = true;
    check.exposure_ms = 16.0;
    check.width = 1392;
    check.height = 1042;
    check.Of(CheckFigure::kLevel) = {level0, level1};
    check.Of(CheckFigure::kRedGreen) = {std::nullopt, std::nullopt};
    check.Of(CheckFigure::kFrameRate) = {28.0};
    return check;
  }
  void AddDays(int days, double level = 1000.0) {
    for (int day = 0; day < days; ++day) book_.Add(Check(day, level + (day % 2 == 0 ? 3.0 : -3.0)));
  }

  SelfcheckBook book_;
};

TEST_F(SelfcheckTrendTest, AFigureThatLeavesTheDaysBeforeIsTold) {
  AddDays(14);
  book_.Add(Check(14, 900.0));
  const SelfcheckTrend trend = TrendOf(book_);
  EXPECT_EQ(trend.days, 14);
  ASSERT_EQ(trend.drifts.size(), 1U);
  const FigureDrift& drift = trend.drifts[0];
  EXPECT_EQ(drift.figure, CheckFigure::kLevel);
  EXPECT_EQ(drift.projector, 0);
  EXPECT_DOUBLE_EQ(drift.value, 900.0);
  EXPECT_NEAR(drift.usual.median, 1000.0, 3.0);
  EXPECT_THAT(ToText(drift, trend.days), HasSubstr("level of projector 0: 900, usually"));
  EXPECT_THAT(TrendAsText(trend), HasSubstr("drift: level of projector 0"));
}

TEST_F(SelfcheckTrendTest, FewerThanEightDaysSayNothing) {
  AddDays(7);
  book_.Add(Check(7, 1.0));
  EXPECT_EQ(TrendOf(book_).days, 7);
  EXPECT_THAT(TrendOf(book_).drifts, IsEmpty());
  EXPECT_THAT(TrendAsText(TrendOf(book_)), HasSubstr("7 earlier days"));
  book_.Add(Check(8, 1000.0));
  book_.Add(Check(9, 1.0));
  EXPECT_EQ(TrendOf(book_).drifts.size(), 1U);
}

TEST_F(SelfcheckTrendTest, ADayThatIsCheckedOftenIsOneDay) {
  AddDays(8);
  for (int i = 0; i < 20; ++i) book_.Add(Check(8.0 + 0.01 * i, 900.0));
  const SelfcheckTrend trend = TrendOf(book_);
  EXPECT_EQ(trend.days, 8) << "neither today's nor more than one a day";
  EXPECT_EQ(trend.drifts.size(), 1U);
}

TEST_F(SelfcheckTrendTest, FailedChecksAndOtherSetupsAreNoMeasure) {
  AddDays(14);
  for (int i = 0; i < 10; ++i) {
    Selfcheck failed = Check(14 + i, 20.0);
    failed.passed = false;
    book_.Add(failed);
    Selfcheck longer = Check(14.5 + i, 2000.0);
    longer.exposure_ms = 32.0;
    book_.Add(longer);
  }
  EXPECT_EQ(TrendOf(book_).days, 9) << "those of 32 ms";
  book_.Add(Check(25, 1000.0));
  EXPECT_EQ(TrendOf(book_).days, 14);
  EXPECT_THAT(TrendOf(book_).drifts, IsEmpty());
}

// A rig that answers alike to the digit: what nobody need look at is no drift.
TEST_F(SelfcheckTrendTest, DaysThatAreAllAlikeMakeNoDriftOfATrifle) {
  for (int day = 0; day < 12; ++day) book_.Add(Check(day, 1000.0));
  book_.Add(Check(12, 1009.0));
  EXPECT_THAT(TrendOf(book_).drifts, IsEmpty());
  book_.Add(Check(13, 1011.0));
  EXPECT_EQ(TrendOf(book_).drifts.size(), 1U);
}

// The 30 days that count are the last ones: a lamp that was replaced is the usual one after a while.
TEST_F(SelfcheckTrendTest, WhatChangedForGoodIsUsualAfterAMonthOfDays) {
  AddDays(30);
  for (int day = 30; day < 60; ++day) book_.Add(Check(day, 1500.0 + day % 3));
  book_.Add(Check(60, 1501.0));
  EXPECT_THAT(TrendOf(book_).drifts, IsEmpty());
  EXPECT_EQ(TrendOf(book_).checks.size(), SelfcheckTrend::kMostShown);
}

// Of normal figures that nothing changed. The rates are those that the header promises.
TEST(UsualFigures, AreLeftByChanceAsSeldomAsIsSaid) {
  std::mt19937 random(7);
  std::normal_distribution<double> noise(1000.0, 100.0);  // far above a hundredth: `least` plays no part
  for (const auto& [days, most_permille] : {std::pair{8, 1.0}, {12, 0.67}, {30, 0.33}}) {
    constexpr int kTries = 100'000;
    int far = 0;
    for (int i = 0; i < kTries; ++i) {
      std::vector<double> before(static_cast<size_t>(days));
      for (double& one : before) one = noise(random);
      const auto usual = UsualOf(CheckFigure::kLevel, before);
      far += std::abs(noise(random) - usual->median) > usual->limit ? 1 : 0;
    }
    const double permille = 1000.0 * far / kTries;
    EXPECT_LT(permille, most_permille * 1.5) << days << " days";  // and the chance of so few
    EXPECT_GT(permille, 0.02) << days << " days: nothing would ever be found";
  }
}

TEST(UsualFigures, AreLeftByALampThatLostATenth) {
  std::mt19937 random(8);
  std::normal_distribution<double> noise(1000.0, 8.0);
  int found = 0;
  for (int i = 0; i < 1000; ++i) {
    std::vector<double> before(20);
    for (double& one : before) one = noise(random);
    const auto usual = UsualOf(CheckFigure::kLevel, before);
    found += std::abs(noise(random) - 100.0 - usual->median) > usual->limit ? 1 : 0;
  }
  EXPECT_GT(found, 950);
}

TEST_F(SelfcheckTrendTest, OneBadDayAmongThoseBeforeHidesNothing) {
  AddDays(14);
  book_.Add(Check(14, 100.0));  // the card was upside down, and it passed
  book_.Add(Check(15, 900.0));
  EXPECT_EQ(TrendOf(book_).drifts.size(), 1U);
}

TEST_F(SelfcheckTrendTest, TheBookIsReadAsItWasWrittenAndIsBounded) {
  AddDays(150, 1234.56789);
  EXPECT_EQ(book_.checks().size(), SelfcheckBook::kMostChecks);
  const SelfcheckBook again = SelfcheckBook::From(book_.ToJson());
  EXPECT_EQ(again.checks(), book_.checks());
  SelfcheckBook wide;
  for (int day = 0; day < 100; ++day) {
    Selfcheck check = Check(day, 1.0);
    for (auto& values : check.figures) values.assign(64, 1234.5);
    wide.Add(check);
  }
  const std::string text = wide.ToJson();
  EXPECT_LT(text.size(), 64U * 1024U) << "a state file of more is not read";
  const SelfcheckBook newest = SelfcheckBook::From(text);
  EXPECT_GT(newest.checks().size(), 8U);
  EXPECT_EQ(newest.checks().back(), wide.checks().back());
}

TEST_F(SelfcheckTrendTest, WhatItDoesNotWriteItDoesNotTake) {
  book_.Add(Check(0, std::nan("")));
  EXPECT_FALSE(book_.checks()[0].Of(CheckFigure::kLevel)[0]) << "no figure";
  const auto with = [this](const char* where, const Json& value) {
    Json json = Json::parse(book_.ToJson());
    json[Json::json_pointer(where)] = value;
    return json.dump();
  };
  EXPECT_NO_THROW(static_cast<void>(SelfcheckBook::From(with("/checks/0/figures/level/0", 7.5))));
  EXPECT_THROW(static_cast<void>(SelfcheckBook::From(with("/checks/0/figures/level/0", "7.5"))), Json::exception);
  EXPECT_THROW(static_cast<void>(SelfcheckBook::From(with("/checks/0/figures/level", 7.5))), Json::exception);
  EXPECT_THROW(static_cast<void>(SelfcheckBook::From(with("/checks/0/figures", Json::object()))), Json::exception);
  EXPECT_THROW(static_cast<void>(SelfcheckBook::From(with("/checks/0/at", int64_t{1} << 62))), Json::exception);
  EXPECT_THROW(static_cast<void>(SelfcheckBook::From(with("/checks/0/passed", 1))), Json::exception);
  EXPECT_THROW(static_cast<void>(SelfcheckBook::From(with("/checks", 7))), Json::exception);
}

TEST_F(SelfcheckTrendTest, IsOneJsonObject) {
  AddDays(14);
  book_.Add(Check(14, 900.0));
  const Json json = Json::parse(TrendAsJson(TrendOf(book_)));
  EXPECT_EQ(json["checks"].size(), 15U);
  EXPECT_EQ(json["checks"][14]["figures"]["level"][0], 900.0);
  EXPECT_EQ(json["checks"][14]["figures"]["red_green"][0], nullptr);
  EXPECT_EQ(json["drifts"][0]["figure"], "level");
  EXPECT_EQ(json["usual"]["level"].size(), 2U);
  EXPECT_EQ(Json::parse(TrendAsJson({}))["checks"].size(), 0U);
}

}  // namespace
}  // namespace stratalux::rig
