// SPDX-License-Identifier: Apache-2.0
// When a night is, for a clock that is given.
#include "fitter/batch/time_of_day.h"

#include <cstdlib>

#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

using namespace std::chrono_literals;

class TimeOfDay : public ::testing::Test {
 protected:
  void SetUp() override {
    const char* zone = std::getenv("TZ");
    before_ = zone != nullptr ? zone : "";
    had_one_ = zone != nullptr;
    // Central Europe, without the system's tables: summer from 2026-03-29 02:00 to 2026-10-25 03:00.
    setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3", 1);
    tzset();
  }
  void TearDown() override {
    had_one_ ? setenv("TZ", before_.c_str(), 1) : unsetenv("TZ");
    tzset();
  }
  static std::time_t At(int month, int day, int hour, int minute, int second = 0) {
    std::tm time{};
    time.tm_year = 126;
    time.tm_mon = month - 1;
    time.tm_mday = day;
    time.tm_hour = hour;
    time.tm_min = minute;
    time.tm_sec = second;
    time.tm_isdst = -1;
    return std::mktime(&time);
  }

 private:
  std::string before_;
  bool had_one_ = false;
};

TEST_F(TimeOfDay, IsTheNextOne) {
  EXPECT_EQ(TimeUntil("07:00", At(5, 14, 20, 0)).value(), 11h);
  EXPECT_EQ(TimeUntil("07:00", At(5, 14, 6, 59, 59)).value(), 1s);
  EXPECT_EQ(TimeUntil("07:00", At(5, 14, 7, 0)).value(), 24h) << "it says so now; the next time is tomorrow";
  EXPECT_EQ(TimeUntil("07:00", At(12, 31, 20, 30)).value(), 10h + 30min);
}

TEST_F(TimeOfDay, ComesWhereTheClockIsSetForSummerAndWinter) {
  EXPECT_EQ(TimeUntil("07:00", At(3, 28, 20, 0)).value(), 10h);
  EXPECT_EQ(TimeUntil("07:00", At(10, 24, 20, 0)).value(), 12h);
}

TEST_F(TimeOfDay, WasLastTodayOrYesterday) {
  const auto since = [](std::time_t now) { return TimeSince("20:00", now, "--from").value(); };
  EXPECT_EQ(since(At(5, 15, 7, 5)), 11h + 5min);
  EXPECT_EQ(since(At(5, 15, 20, 0)), 0s);
  EXPECT_EQ(since(At(5, 15, 19, 59, 59)), 23h + 59min + 59s);
  EXPECT_EQ(since(At(1, 1, 7, 0)), 11h);
  EXPECT_EQ(since(At(3, 29, 7, 0)), 10h);
  EXPECT_EQ(since(At(10, 25, 7, 0)), 12h);
  EXPECT_EQ(TimeSince("x", 0, "--from").status().message(), "--from x: expected a time of day, such as 07:00");
}

TEST_F(TimeOfDay, IsNothingElse) {
  for (const char* text : {"", "7", "24:00", "07:60", "-1:00", "07:00 ", "07:00x", "soon"}) {
    EXPECT_EQ(TimeUntil(text, At(5, 14, 20, 0)).status().code(), StatusCode::kUsage) << text;
    EXPECT_EQ(IsBetween(text, "07:00", At(5, 14, 20, 0)).status().code(), StatusCode::kUsage) << text;
  }
  EXPECT_EQ(IsBetween("x", "07:00", 0).status().message(), "--from x: expected a time of day, such as 07:00");
}

// A night that fails at its end and is begun again five minutes later fits nobody by day.
TEST_F(TimeOfDay, ANightIsFromItsBeginningToItsEnd) {
  const auto between = [](std::time_t now) { return IsBetween("20:00", "07:00", now).value(); };
  EXPECT_TRUE(between(At(5, 14, 20, 0)));
  EXPECT_TRUE(between(At(5, 14, 23, 59, 59)));
  EXPECT_TRUE(between(At(5, 15, 0, 0)));
  EXPECT_TRUE(between(At(5, 15, 6, 59, 59)));
  EXPECT_FALSE(between(At(5, 15, 7, 0)));
  EXPECT_FALSE(between(At(5, 15, 7, 5)));
  EXPECT_FALSE(between(At(5, 15, 19, 59, 59)));
  EXPECT_TRUE(IsBetween("01:00", "05:00", At(5, 15, 3, 0)).value());
  EXPECT_FALSE(IsBetween("01:00", "05:00", At(5, 15, 23, 0)).value());
  EXPECT_EQ(IsBetween("07:00", "07:00", At(5, 15, 3, 0)).status().code(), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
