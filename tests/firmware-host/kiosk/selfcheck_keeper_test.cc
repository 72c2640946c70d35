// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/selfcheck_keeper.h"

#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/session/state_file.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class SelfcheckKeeping : public ScratchFolderTest {
 protected:
  static Selfcheck Check(double level) {
    Selfcheck check;
    check.at = {1795507200'000'000'000};
    check.passed = true;
    check.Of(CheckFigure::kLevel) = {level};
    return check;
  }
  const fs::path file_ = SelfchecksFile(folder_, false);
  Logger logger_{LogLevel::kError};
};

TEST_F(SelfcheckKeeping, OutlivesTheProgram) {
  SelfcheckKeeper(file_, logger_).Add(Check(1000.0));
  SelfcheckKeeper keeper(file_, logger_);
  keeper.Add(Check(1001.0));
  EXPECT_EQ(SelfcheckKeeper(file_, logger_).trend().checks.size(), 2U);
  EXPECT_EQ(keeper.trend().note, "");
}

TEST_F(SelfcheckKeeping, OfTheSimulatedRigIsApart) {
  EXPECT_NE(SelfchecksFile(folder_, true), file_);
  SelfcheckKeeper(SelfchecksFile(folder_, true), logger_).Add(Check(1000.0));
  EXPECT_TRUE(SelfcheckKeeper(file_, logger_).trend().checks.empty());
}

TEST_F(SelfcheckKeeping, SaysWhatIsDamagedOrNewerSetsItAsideAndGoesOn) {
  for (const auto& [text, aside] :
       {std::pair{R"({"schema": 1, "checks": 7})", ".damaged"}, {R"({"schema": 2})", ".newer"}}) {
    ASSERT_TRUE(KeepState(file_, text).ok());
    SelfcheckKeeper keeper(file_, logger_);
    EXPECT_THAT(keeper.trend().note, HasSubstr(file_.string() + aside));
    EXPECT_TRUE(fs::exists(file_.string() + aside));
    keeper.Add(Check(1000.0));
    EXPECT_EQ(keeper.trend().note, "");
    EXPECT_EQ(SelfcheckKeeper(file_, logger_).trend().checks.size(), 1U);
  }
}

TEST_F(SelfcheckKeeping, WhatMayBeSomebodyElsesIsSaidAndLeft) {
  SelfcheckKeeper(file_, logger_).Add(Check(1000.0));
  fs::permissions(file_, fs::perms::all);
  SelfcheckKeeper keeper(file_, logger_);
  keeper.Add(Check(2000.0));
  EXPECT_THAT(keeper.trend().note, HasSubstr("it stays as it is"));
  fs::permissions(file_, fs::perms::owner_read | fs::perms::owner_write);
  EXPECT_EQ(SelfcheckKeeper(file_, logger_).trend().checks.size(), 1U);
}

TEST_F(SelfcheckKeeping, WithoutADiskIsSaidAndTheTrendIsOfThisProgram) {
  SelfcheckKeeper keeper("/nonexistent/selfchecks.json", logger_);
  keeper.Add(Check(1000.0));
  EXPECT_THAT(keeper.trend().note, HasSubstr("/nonexistent"));
  EXPECT_EQ(keeper.trend().checks.size(), 1U);
}

TEST_F(SelfcheckKeeping, ACheckThatLitNothingHasNoFigures) {
  RigCheckReport report;
  report.card.resize(4);
  EXPECT_FALSE(SelfcheckOf(report, 16.0));
}

}  // namespace
}  // namespace stratalux::rig
