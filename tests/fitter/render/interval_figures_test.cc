// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/interval_figures.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// Two lights, three colours; errors of 5 % of the light times `error`, without noise.
HeldOutErrors HoldOut(int projector, double error, int samples = 5000) {
  Random random(static_cast<uint64_t>(projector) + 1);
  HeldOutErrors made{projector, {"stripe", "white"}, 3, {}};
  made.samples.resize(6);
  for (auto& of : made.samples)
    for (int k = 0; k < samples; ++k) {
      const double p = 50.0 + 100.0 * random.Uniform(), off = 0.05 * error * p * random.Normal();
      of.push_back(
          {{static_cast<float>(p), 0.0F, 0.0F, 0.0F}, static_cast<float>(off), static_cast<float>(off * off), 0.0F});
    }
  return made;
}

TEST(IntervalFigures, HoldForALightLikeTheOthersAndNotForAWorseOne) {
  const auto alike = FindIntervals({HoldOut(0, 1.0), HoldOut(1, 1.0), HoldOut(2, 1.0)});
  EXPECT_THAT(alike.learnt_from, ElementsAre(0, 1, 2));
  EXPECT_THAT(alike.colours, SizeIs(3));
  ASSERT_THAT(alike.covered, SizeIs(6));
  for (const auto& c : alike.covered) {
    EXPECT_NEAR(c.share, 0.95, 0.02) << c.projector << c.light;
    EXPECT_NEAR(c.half_width, 1.96 * 0.05, 0.01);
    EXPECT_EQ(c.samples, 15000);
  }
  // Its own errors are no part of what it is judged by.
  const auto worse = FindIntervals({HoldOut(0, 1.0), HoldOut(1, 1.0), HoldOut(2, 3.0)});
  for (const auto& c : worse.covered) {
    if (c.projector == 2) {
      EXPECT_NEAR(c.share, 0.487, 0.025) << "a third of 1.96 standard deviations";
    }
  }
}

TEST(IntervalFigures, OneHoldOutIsLearntFromAndNotChecked) {
  const auto one = FindIntervals({HoldOut(3, 1.0)});
  EXPECT_THAT(one.colours, SizeIs(3));
  EXPECT_THAT(one.covered, IsEmpty());
  EXPECT_THAT(FindIntervals({}).colours, IsEmpty());
}

TEST(IntervalFigures, TooLittleOrUnlikeSaysNothing) {
  EXPECT_THAT(FindIntervals({HoldOut(0, 1.0, 20)}).colours, IsEmpty());
  HeldOutErrors mono{1, {}, 1, {}};
  const auto unlike = FindIntervals({HoldOut(0, 1.0), mono});
  EXPECT_THAT(unlike.colours, IsEmpty());
}

class IntervalFiles : public ScratchFolderTest {};

TEST_F(IntervalFiles, ErrorsComeBackAndOthersAreRefused) {
  HeldOutErrors saved = HoldOut(0, 1.0, 5);
  for (auto& of : saved.samples) of[4].causes = {60.0F, 0.5F, 7.0F, 11.0F};
  ASSERT_TRUE(SaveErrors(folder_, saved).ok());
  HeldOutErrors read{0, {"stripe", "white"}, 3, {}};
  ASSERT_TRUE(LoadErrors(folder_, read).ok());
  ASSERT_THAT(read.samples, SizeIs(6));
  for (size_t of = 0; of < 6; ++of) {
    ASSERT_THAT(read.samples[of], SizeIs(5));
    EXPECT_EQ(read.samples[of][4].residual, saved.samples[of][4].residual);
    EXPECT_EQ(read.samples[of][4].causes.prediction, saved.samples[of][4].causes.prediction);
    EXPECT_EQ(read.samples[of][4].causes.tan_incidence, saved.samples[of][4].causes.tan_incidence);
    EXPECT_EQ(read.samples[of][4].causes.step, saved.samples[of][4].causes.step);
    EXPECT_EQ(read.samples[of][4].causes.spread, saved.samples[of][4].causes.spread);
  }
  HeldOutErrors fewer{0, {"stripe"}, 3, {}};
  EXPECT_EQ(LoadErrors(folder_, fewer).code(), StatusCode::kIntegrity);
}

TEST_F(IntervalFiles, MetricsOfAnotherProgramSayNothing) {
  WriteText(folder_ / "metrics.json", R"({"schema": 2, "prediction": []})");
  const auto older = ReadIntervals(folder_ / "metrics.json");
  ASSERT_TRUE(older.ok()) << older.status().message();
  EXPECT_THAT(older->colours, IsEmpty());
  for (const char* schema : {"", R"("schema": 1, )", R"("schema": 3, )"}) {  // whose parts mean something else
    WriteText(folder_ / "metrics.json", R"({"schema": 2, "intervals": {)" + std::string(schema) +
                                            R"("learnt_from": [0], "colours": [{"placement_quads": 0.1}]}})");
    const auto other = ReadIntervals(folder_ / "metrics.json");
    ASSERT_TRUE(other.ok()) << other.status().message();
    EXPECT_THAT(other->colours, IsEmpty()) << schema;
  }
  EXPECT_EQ(ReadIntervals(folder_ / "none.json").status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace stratalux::fit
