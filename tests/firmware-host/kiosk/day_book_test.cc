// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/day_book.h"

#include <cstdlib>
#include <ctime>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::Pair;
using Json = nlohmann::json;

// A wall clock in Tokyo, where a day begins at 15:00 UTC.
class DayBookTest : public ::testing::Test {
 protected:
  void SetUp() override { SetZone("Asia/Tokyo"); }
  void TearDown() override { SetZone("UTC0"); }
  static void SetZone(const char* zone) {
    setenv("TZ", zone, 1);
    tzset();
  }
  const WallNs evening_{1795532400 * kSecondNs};  // 2026-11-24T15:00:00Z: midnight that begins the 25th there
  [[nodiscard]] WallNs At(double hours) const {
    return {evening_.ns + static_cast<int64_t>(hours * (3600 * kSecondNs))};
  }
};

TEST_F(DayBookTest, ADayIsThatOfTheComputersTimeZone) {
  EXPECT_EQ(LocalDay(At(-0.001)), "2026-11-24");
  EXPECT_EQ(LocalDay(evening_), "2026-11-25");
}

TEST_F(DayBookTest, IsReadAsItWasWritten) {
  DayBook book;
  book.Begun(At(-3));
  book.Retaken(At(-3));
  book.Ended("kept", At(-2.9));
  book.Told(Word::kLamp, At(-2.9));
  book.Begun(At(-2));
  const DayBook again = DayBook::From(book.ToJson());
  EXPECT_EQ(again.ToJson(), book.ToJson());
  EXPECT_EQ(again.Today(At(-1)), book.Today(At(-1)));
  EXPECT_EQ(again.LastFaults(At(-1)), book.LastFaults(At(-1)));
  EXPECT_EQ(again.changes(), 0);
}

TEST_F(DayBookTest, AVisitThatTheProgramsEndCutOffIsCountedOnceOnItsDay) {
  DayBook book;
  book.Begun(At(-0.01));
  DayBook next = DayBook::From(book.ToJson());  // killed; it starts again behind midnight
  next.CutOff();
  next.CutOff();
  EXPECT_THAT(next.Today(At(-1)).visits, ElementsAre(Pair("cut_off", 1)));
  EXPECT_EQ(next.Today(At(-1)).visits_begun, 1);
  EXPECT_THAT(next.Today(At(1)).visits, IsEmpty());
}

TEST_F(DayBookTest, AClockThatIsSetBackOverMidnightLosesNothingAndCountsNothingTwice) {
  DayBook book;
  book.Begun(At(-1));
  book.Ended("refused", At(-1));
  book.Begun(At(0.5));
  book.Ended("left", At(0.5));
  book.Begun(At(-0.5));  // set back by an hour
  book.Ended("refused", At(-0.5));
  book.Begun(At(0.75));
  book.Ended("kept", At(0.75));
  EXPECT_THAT(book.Today(At(-0.1)).visits, ElementsAre(Pair("refused", 2)));
  EXPECT_THAT(book.Today(At(1)).visits, ElementsAre(Pair("kept", 1), Pair("left", 1)));
  ASSERT_EQ(book.Others(At(1)).size(), 1U);
  EXPECT_EQ(book.Others(At(1))[0].day, "2026-11-24");
}

TEST_F(DayBookTest, IsBoundedWhateverTheClockDoes) {
  DayBook book;
  for (int day = 0; day < 400; ++day)
    for (int i = 0; i < 20; ++i) {
      for (int word = 0; word < kWords; ++word) {
        book.Told(static_cast<Word>(word), At(24.0 * ((day * 7919) % 4000)));
        book.Ended(ToString(static_cast<Word>(word)), At(24.0 * day));
      }
    }
  EXPECT_LT(book.ToJson().size(), 30'000U);
  EXPECT_LE(book.Others(At(0)).size(), DayBook::kMostDays);
  EXPECT_EQ(DayBook::From(book.ToJson()).ToJson(), book.ToJson());
}

TEST_F(DayBookTest, FaultsOfTheDayAreThoseOfTheDay) {
  DayBook book;
  book.Told(Word::kLamp, At(24 * 365));  // a clock that was wrong
  book.Told(Word::kDoor, At(0));
  for (int i = 0; i < 60; ++i) book.Told(Word::kProof, At(20));
  EXPECT_EQ(book.LastFaults(At(21)).size(), DayBook::kMostFaults);
  EXPECT_EQ(book.LastFaults(At(21)).front().word, "proof");
  EXPECT_THAT(book.LastFaults(At(45)), IsEmpty());
  EXPECT_EQ(book.Today(At(1)).faults.at("door"), 1);
  EXPECT_EQ(book.Today(At(20)).faults.at("proof"), 60);
}

TEST_F(DayBookTest, WhatItDoesNotWriteItDoesNotTake) {
  const auto with = [](const char* where, const Json& value) {
    DayBook book;
    book.Told(Word::kLamp, {0});
    Json json = Json::parse(book.ToJson());
    json[Json::json_pointer(where)] = value;
    return json.dump();
  };
  EXPECT_NO_THROW(static_cast<void>(DayBook::From(with("/days/0/retakes", 7))));
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/days/0/retakes", -1))), Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/days/0/retakes", 1.5))), Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/days/0/day", "yesterday"))), Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/days/0/faults/<b>", 1))), Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/days/0/visits", Json::array()))), Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/days", Json::array({{}, {}, {}, {}, {}, {}, {}, {}, {}})))),
               Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/last_faults/0/at", int64_t{1} << 62))), Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/last_faults/0/word", ""))), Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From(with("/open", 7))), Json::exception);
  EXPECT_THROW(static_cast<void>(DayBook::From("{}")), Json::exception);
}

}  // namespace
}  // namespace stratalux::rig
