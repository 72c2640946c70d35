// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/thin_plan.h"

#include <algorithm>
#include <map>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;

CapturePlan PlanOf(const PlanOptions& options = {}) {
  auto plan = BuildPlan(options);
  EXPECT_TRUE(plan.ok()) << plan.status().message();
  return std::move(plan).value();
}

ThinPlan Thin(const CapturePlan& plan, int frames) {
  auto thin = ThinTo(plan, frames);
  EXPECT_TRUE(thin.ok()) << thin.status().message();
  return std::move(thin).value();
}

// Kept steps of a projector, by phase.
std::map<CapturePhase, int> Kept(const CapturePlan& plan, const ThinPlan& thin, int projector) {
  std::map<CapturePhase, int> kept;
  for (const int step : thin.kept)
    if (plan.steps[static_cast<size_t>(step)].projector == projector)
      ++kept[plan.steps[static_cast<size_t>(step)].phase];
  return kept;
}

std::vector<int> CombsOf(const CapturePlan& plan, const ThinPlan& thin, int projector) {
  std::vector<int> shifts;
  for (const int index : thin.kept) {
    const PlanStep& step = plan.steps[static_cast<size_t>(index)];
    if (step.projector == projector && step.phase == CapturePhase::kSweep) shifts.push_back(step.pattern.shift);
  }
  return shifts;
}

TEST(ThinPlan, KeepsAtMostWhatWasAskedForAndEveryProjectorAlike) {
  const CapturePlan plan = PlanOf();
  for (int frames = 24; frames < 500; ++frames) {
    const ThinPlan thin = Thin(plan, frames);
    EXPECT_LE(static_cast<int>(thin.kept.size()), frames);
    EXPECT_TRUE(std::ranges::is_sorted(thin.kept));
    EXPECT_EQ(std::set<int>(thin.kept.begin(), thin.kept.end()).size(), thin.kept.size());
    for (int p = 1; p < 4; ++p) EXPECT_EQ(Kept(plan, thin, p), Kept(plan, thin, 0)) << frames;
  }
}

TEST(ThinPlan, NeverDropsWhiteAndBlack) {
  const CapturePlan plan = PlanOf();
  for (const int frames : {24, 25, 64, 128, 256, 499})
    for (int p = 0; p < 4; ++p) EXPECT_EQ(Kept(plan, Thin(plan, frames), p)[CapturePhase::kReference], 2) << frames;
}

TEST(ThinPlan, CombsAreEvenOverTheCycle) {
  const CapturePlan plan = PlanOf();
  for (int frames = 24; frames < 500; frames += 7) {
    const ThinPlan thin = Thin(plan, frames);
    const std::vector<int> shifts = CombsOf(plan, thin, 2);
    ASSERT_EQ(static_cast<int>(shifts.size()), 64 / thin.comb_every) << frames;
    for (size_t k = 0; k < shifts.size(); ++k) EXPECT_EQ(shifts[k], static_cast<int>(k) * 2 * thin.comb_every);
  }
}

// More frames, no less of anything that has no substitute.
TEST(ThinPlan, MoreFramesNeverMeanFewerCombsOrNoSurface) {
  const CapturePlan plan = PlanOf();
  ThinPlan before = Thin(plan, 24);
  for (int frames = 25; frames <= 500; ++frames) {
    const ThinPlan thin = Thin(plan, frames);
    EXPECT_LE(thin.comb_every, before.comb_every) << frames;
    EXPECT_GE(thin.columns, before.columns) << frames;
    EXPECT_GE(thin.sinusoids.size(), before.sinusoids.size()) << frames;
    EXPECT_GE(thin.kept.size(), before.kept.size()) << frames;
    before = thin;
  }
}

// The table of docs/capture-plan.md.
TEST(ThinPlan, WhatTheDocumentSays) {
  const CapturePlan plan = PlanOf();
  const struct {
    int frames, kept, combs, codes, sinusoids, evaluation_only;
  } table[] = {{499, 480, 64, 40, 8, 12},
               {256, 256, 32, 20, 8, 24},
               {128, 128, 16, 10, 4, 28},
               {64, 64, 8, 0, 4, 24},
               {24, 24, 4, 0, 0, 28}};
  for (const auto& row : table) {
    const ThinPlan thin = Thin(plan, row.frames);
    auto kept = Kept(plan, thin, 1);
    EXPECT_EQ(static_cast<int>(thin.kept.size()), row.kept);
    EXPECT_EQ(kept[CapturePhase::kSweep], row.combs) << row.frames;
    EXPECT_EQ(kept[CapturePhase::kCorrespondence], row.codes) << row.frames;
    EXPECT_EQ(kept[CapturePhase::kSeparation], row.sinusoids) << row.frames;
    EXPECT_EQ(thin.evaluation_only, row.evaluation_only) << row.frames;
    EXPECT_EQ(thin.columns, row.codes > 0) << row.frames;
  }
  EXPECT_EQ(LeastForSurface(plan), 96);
}

TEST(ThinPlan, SaysWhatIsLeftOut) {
  const CapturePlan plan = PlanOf();
  const ThinPlan thin = Thin(plan, 128);
  EXPECT_THAT(thin.left_out, Contains("combs: 48 of 64"));
  EXPECT_THAT(thin.left_out, Contains("inverse codes of columns: 10"));
  EXPECT_THAT(thin.left_out, Contains("codes of rows: 10"));
  EXPECT_THAT(Describe(thin), HasSubstr("128 of 500 frames"));
}

TEST(ThinPlan, NothingThatNoStageReads) {
  PlanOptions options;
  options.checkerboard = true;
  options.spot_brackets = {1.0, 4.0};
  const CapturePlan plan = PlanOf(options);
  const ThinPlan thin = Thin(plan, static_cast<int>(plan.steps.size()) - 1);
  for (const int index : thin.kept) {
    const PlanStep& step = plan.steps[static_cast<size_t>(index)];
    EXPECT_NE(step.phase, CapturePhase::kPreroll);
    EXPECT_NE(step.phase, CapturePhase::kSpot);
    EXPECT_NE(step.phase, CapturePhase::kRepeat);
    EXPECT_NE(step.pattern.kind, PatternKind::kCheckerboard);
  }
}

TEST(ThinPlan, FurtherExposuresAndRowsGoFirst) {
  PlanOptions options;
  options.brackets = {1.0, 4.0};
  options.row_sweep = true;
  const CapturePlan plan = PlanOf(options);
  const ThinPlan thin = Thin(plan, 256);
  EXPECT_FALSE(thin.row_sweep);
  for (const int index : thin.kept) EXPECT_EQ(plan.steps[static_cast<size_t>(index)].bracket, 0);
  EXPECT_TRUE(Thin(plan, 2000).row_sweep);
}

TEST(ThinPlan, AllFramesAreTheWholePlan) {
  const CapturePlan plan = PlanOf();
  EXPECT_TRUE(Thin(plan, 500).IsWhole());
  EXPECT_TRUE(Thin(plan, 5000).IsWhole());
  EXPECT_FALSE(Thin(plan, 499).IsWhole());
}

TEST(ThinPlan, RefusesTooFewAndOtherKinds) {
  const auto few = ThinTo(PlanOf(), 23);
  ASSERT_EQ(few.status().code(), StatusCode::kUsage);
  EXPECT_THAT(few.status().message(), HasSubstr("23"));
  EXPECT_THAT(few.status().message(), HasSubstr("24"));
  PlanOptions calibration;
  calibration.kind = SessionKind::kCalibration;
  EXPECT_EQ(ThinTo(PlanOf(calibration), 100).status().code(), StatusCode::kUsage);
}

// A cycle that no power of two divides keeps all of its combs.
TEST(ThinPlan, OddCyclesStayWhole) {
  PlanOptions options;
  options.comb_period = 30;
  const CapturePlan plan = PlanOf(options);
  EXPECT_EQ(Thin(plan, 100).comb_every, 1);
}

}  // namespace
}  // namespace stratalux
