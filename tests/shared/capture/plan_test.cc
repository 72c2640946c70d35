// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/plan.h"

#include <algorithm>
#include <map>
#include <set>

#include <gtest/gtest.h>

namespace stratalux {
namespace {

TEST(CapturePlan, DefaultHasTheFrameCountOfTheModel) {
  const auto plan = BuildPlan({});
  ASSERT_TRUE(plan.ok());
  EXPECT_EQ(plan->steps.size(), 500U);  // 4 x 123 + 8 pre-roll markers (model section 2)
  std::map<int, int> per_projector;
  for (const PlanStep& step : plan->steps) ++per_projector[step.projector];
  EXPECT_EQ(per_projector[-1], 8);
  for (int p = 0; p < 4; ++p) EXPECT_EQ(per_projector[p], 123);
}

TEST(CapturePlan, StepsAreNumberedInOrder) {
  const auto plan = BuildPlan({});
  ASSERT_TRUE(plan.ok());
  for (size_t i = 0; i < plan->steps.size(); ++i) EXPECT_EQ(plan->steps[i].index, static_cast<int>(i));
}

TEST(CapturePlan, SweepLightsEveryColumnOncePerWidthOverStep) {
  PlanOptions options;
  options.comb_width = 4;
  options.comb_step = 2;
  options.row_sweep = true;
  options.brackets = {1.0, 4.0};
  const auto plan = BuildPlan(options);
  ASSERT_TRUE(plan.ok()) << plan.status().message();
  std::vector<float> lit(1024, 0.0F);
  int rows = 0, bracketed = 0;
  for (const PlanStep& step : plan->steps) {
    if (step.projector != 2 || step.phase != CapturePhase::kSweep) continue;
    if (step.pattern.axis == PatternAxis::kRows) ++rows;
    if (step.bracket == 1) {
      ++bracketed;
      EXPECT_DOUBLE_EQ(step.exposure_ms, 4.0 * options.exposure_ms);
    }
    if (step.bracket != 0 || step.pattern.axis != PatternAxis::kColumns) continue;
    const auto profile = step.pattern.Profile(1024);
    for (size_t c = 0; c < lit.size(); ++c) lit[c] += profile[c];
  }
  for (float l : lit) EXPECT_EQ(l, 2.0F);
  EXPECT_EQ(rows, 128);
  EXPECT_EQ(bracketed, 128);
}

std::vector<int> StepsOf(const CapturePlan& plan, int projector, CapturePhase phase) {
  std::vector<int> steps;
  for (const PlanStep& step : plan.steps)
    if (step.projector == projector && step.phase == phase) steps.push_back(step.index);
  return steps;
}

TEST(SecondTakes, ShowStripeAndSpotsOfEachProjectorOnceMoreASweepLater) {
  PlanOptions options;
  options.brackets = {0.5, 2.0};
  options.spot_brackets = {1.0, 4.0};
  options.row_sweep = true;
  const CapturePlan plan = *BuildPlan(options);
  for (int p = 0; p < options.projectors; ++p) {
    const std::vector<int> repeats = StepsOf(plan, p, CapturePhase::kRepeat);
    ASSERT_EQ(repeats.size(), 2U);
    const std::vector<int> sweep = StepsOf(plan, p, CapturePhase::kSweep),
                           spots = StepsOf(plan, p, CapturePhase::kSpot);
    for (const auto& [again, first] : {std::pair{repeats[0], sweep[0]}, {repeats[1], spots[0]}}) {
      EXPECT_EQ(plan.steps[again].pattern, plan.steps[first].pattern);
      EXPECT_EQ(plan.steps[again].exposure_ms, plan.steps[first].exposure_ms) << "the first factor of the phase";
      EXPECT_EQ(plan.steps[again].bracket, 0);
      EXPECT_GE(again - first, options.comb_period / options.comb_step);
    }
    EXPECT_EQ(plan.steps[sweep[0]].pattern.shift, 0);
  }
}

// The mean level alone tells spots from what a projector shows that is a step behind or ahead: nothing beside them may
// be nearly as dark as they are.
TEST(SecondTakes, SpotsStandBesideWhiteBlackAndSinusoidsAlone) {
  const CapturePlan plan = *BuildPlan({});
  for (const PlanStep& step : plan.steps) {
    if (step.pattern.kind != PatternKind::kSpots) continue;
    for (const int beside : {step.index - 1, step.index + 1}) {
      const PatternKind kind = plan.steps[beside].pattern.kind;
      EXPECT_TRUE(kind == PatternKind::kWhite || kind == PatternKind::kBlack || kind == PatternKind::kSinusoid)
          << step.index;
    }
  }
}

TEST(SecondTakes, MoveTheSpotsAndChangeNothingElse) {
  for (const bool rows : {false, true}) {
    PlanOptions options;
    options.row_sweep = rows;
    const CapturePlan with = *BuildPlan(options);
    options.second_takes = false;
    const CapturePlan without = *BuildPlan(options);
    // Where the first take of the spots stands is all that differs: before the sweep, so that the second is far from
    // it.
    const auto steps_of = [](const CapturePlan& plan, bool spots) {
      std::vector<PlanStep> steps;
      for (const PlanStep& step : plan.steps)
        if (step.phase != CapturePhase::kRepeat && (step.phase == CapturePhase::kSpot) == spots) steps.push_back(step);
      return steps;
    };
    for (const bool spots : {false, true}) {
      const std::vector<PlanStep> here = steps_of(with, spots), there = steps_of(without, spots);
      ASSERT_EQ(here.size(), there.size());
      ASSERT_FALSE(here.empty());
      for (size_t i = 0; i < here.size(); ++i) {
        EXPECT_EQ(here[i].pattern, there[i].pattern) << i;
        EXPECT_EQ(here[i].phase, there[i].phase) << i;
        EXPECT_EQ(here[i].projector, there[i].projector) << i;
      }
    }
  }
}

TEST(SecondTakes, LeaveOutWhatThePlanLeavesOut) {
  PlanOptions options;
  options.spot_radius = 0;
  for (const int step : StepsOf(*BuildPlan(options), 0, CapturePhase::kRepeat))
    EXPECT_EQ(BuildPlan(options)->steps[step].pattern.kind, PatternKind::kComb);
  for (const SessionKind kind :
       {SessionKind::kCalibration, SessionKind::kDark, SessionKind::kFlat, SessionKind::kResponse}) {
    options.kind = kind;
    EXPECT_TRUE(StepsOf(*BuildPlan(options), 0, CapturePhase::kRepeat).empty()) << ToString(kind);
  }
}

TEST(PrerollCode, NoCyclicOrTruncatingShiftLooksLikeTheCode) {
  const std::vector<bool> code = PrerollCode(8);
  for (int shift = 1; shift < 8; ++shift) {
    int differences = 0;
    for (int i = 0; i + shift < 8; ++i) differences += code[i] != code[i + shift] ? 1 : 0;
    EXPECT_GT(differences, 0) << "shift " << shift;
  }
}

TEST(CapturePlan, RefusesOptionsOutOfRangeByName) {
  PlanOptions options;
  options.comb_step = 3;
  EXPECT_EQ(BuildPlan(options).status().code(), StatusCode::kUsage);
  options = {};
  options.exposure_ms = -1.0;
  EXPECT_NE(BuildPlan(options).status().message().find("exposure_ms"), std::string::npos);
  options = {};
  options.comb_period = 4096;
  EXPECT_NE(BuildPlan(options).status().message().find("exceeds the projector"), std::string::npos);
}

TEST(PlanJson, RoundTripsAndRefusesNewerSchemas) {
  PlanOptions options;
  options.row_sweep = true;
  options.brackets = {1.0, 8.0};
  const std::string text = PlanOptionsToJson(options);
  const auto back = PlanOptionsFromJson(text);
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(PlanOptionsToJson(*back), text);
  std::string newer = text;
  newer.replace(newer.find("\"schema\":1"), 10, "\"schema\":3");
  EXPECT_EQ(PlanOptionsFromJson(newer).status().code(), StatusCode::kNewerSchema);
  // Sessions from before the second takes have none.
  std::string older = text;
  older.erase(older.find("\"second_takes\":true,"), 20);
  ASSERT_TRUE(PlanOptionsFromJson(older).ok()) << older;
  EXPECT_FALSE(PlanOptionsFromJson(older)->second_takes);
  EXPECT_EQ(PlanOptionsFromJson("{").status().code(), StatusCode::kIntegrity);
}

TEST(PlanJson, SaysWhichCodeSoThatOlderProgramsRefuseIt) {
  PlanOptions options;
  const std::string gray = PlanOptionsToJson(options);
  EXPECT_EQ(gray.find("\"code\""), std::string::npos);  // as plans before there were others
  EXPECT_NE(gray.find("\"schema\":1"), std::string::npos);
  options.code = ColumnCode::kXor4;
  const std::string text = PlanOptionsToJson(options);
  EXPECT_NE(text.find("\"schema\":2"), std::string::npos);
  ASSERT_TRUE(PlanOptionsFromJson(text).ok());
  EXPECT_EQ(PlanOptionsFromJson(text)->code, ColumnCode::kXor4);
  EXPECT_EQ(PlanOptionsToJson(*PlanOptionsFromJson(text)), text);
  // In schema 1 a program of before passes the key over, and so does this one.
  std::string older = text;
  older.replace(older.find("\"schema\":2"), 10, "\"schema\":1");
  EXPECT_EQ(PlanOptionsFromJson(older)->code, ColumnCode::kGray);
  std::string later = text;
  later.replace(later.find("xor-4"), 5, "xor-8");
  EXPECT_EQ(PlanOptionsFromJson(later).status().code(), StatusCode::kUsage);
  EXPECT_NE(PlanOptionsFromJson(later).status().message().find("allowed: gray, xor-2"), std::string::npos);
}

TEST(Plan, ShowsTheCodeToVisitorsAlone) {
  PlanOptions options;
  const CapturePlan gray = *BuildPlan(options);
  for (const ColumnCode code :
       {ColumnCode::kXor2, ColumnCode::kXor4, ColumnCode::kMinStripe, ColumnCode::kMicroPhase}) {
    options.code = code;
    for (const SessionKind kind : {SessionKind::kVisitor, SessionKind::kCalibration, SessionKind::kFlat}) {
      options.kind = kind;
      const CapturePlan plan = *BuildPlan(options);
      const ColumnCode shown = kind == SessionKind::kVisitor ? code : ColumnCode::kGray;
      for (const PlanStep& step : plan.steps)
        ASSERT_EQ(step.pattern.code, step.pattern.kind == PatternKind::kGray ? shown : ColumnCode::kGray);
      if (kind != SessionKind::kVisitor) continue;
      ASSERT_EQ(plan.steps.size(), gray.steps.size());  // but for the code the plan is the same
      for (size_t i = 0; i < plan.steps.size(); ++i) {
        Pattern pattern = plan.steps[i].pattern;
        if (!IsOfStripes(pattern.code)) pattern.period = 0;
        pattern.code = ColumnCode::kGray;
        ASSERT_EQ(pattern, gray.steps[i].pattern) << i;
      }
    }
  }
}

TEST(Plan, EachPhaseHasBracketsOfItsOwn) {
  PlanOptions options;
  const size_t plain = BuildPlan(options)->steps.size();
  options.reference_brackets = {1.0, 4.0};
  options.correspondence_brackets = {1.0, 0.5, 2.0};
  options.separation_brackets = {1.0, 3.0};
  options.spot_brackets = {1.0, 8.0};
  const auto plan = BuildPlan(options);
  ASSERT_TRUE(plan.ok());
  const size_t codes = 2 * (10 + 10), shifts = 8;
  EXPECT_EQ(plan->steps.size(), plain + 4 * (2 + 2 * codes + shifts + 1));
  for (const PlanStep& step : plan->steps)
    EXPECT_DOUBLE_EQ(step.exposure_ms, options.exposure_ms * options.BracketsOf(step.phase)[step.bracket]);
  const auto read = PlanOptionsFromJson(PlanOptionsToJson(options));
  ASSERT_TRUE(read.ok());
  EXPECT_EQ(read->separation_brackets, options.separation_brackets);
  EXPECT_EQ(read->spot_brackets, options.spot_brackets);

  options.correspondence_brackets = {0.5, 1.0};
  EXPECT_EQ(BuildPlan(options).status().code(), StatusCode::kUsage);
  options.correspondence_brackets = {};
  EXPECT_EQ(BuildPlan(options).status().code(), StatusCode::kUsage);
}

TEST(LightPlans, RepeatWhatNoiseAndCurvesNeed) {
  auto count = [](const CapturePlan& plan, int projector, CapturePhase phase, PatternKind kind, double exposure_ms) {
    return std::count_if(plan.steps.begin(), plan.steps.end(), [&](const PlanStep& s) {
      return s.projector == projector && s.phase == phase && s.pattern.kind == kind && s.exposure_ms == exposure_ms;
    });
  };
  PlanOptions options;
  options.kind = SessionKind::kDark;
  const CapturePlan dark = *BuildPlan(options);
  for (const double ms : {4.0, 16.0, 64.0})
    EXPECT_EQ(count(dark, 0, CapturePhase::kRadiometry, PatternKind::kBlack, ms), 16);
  EXPECT_EQ(count(dark, 0, CapturePhase::kReference, PatternKind::kWhite, 16.0), 0);

  options.kind = SessionKind::kFlat;
  const CapturePlan flat = *BuildPlan(options);
  for (const double factor : options.BracketsOf(CapturePhase::kRadiometry)) {
    // Pairs of whites and their black, by the first projector alone.
    EXPECT_EQ(count(flat, 0, CapturePhase::kRadiometry, PatternKind::kWhite, 16.0 * factor), 2);
    EXPECT_EQ(count(flat, 0, CapturePhase::kRadiometry, PatternKind::kBlack, 16.0 * factor), 1);
    EXPECT_EQ(count(flat, 1, CapturePhase::kRadiometry, PatternKind::kWhite, 16.0 * factor), 0);
  }
  for (int p = 0; p < 4; ++p) {
    EXPECT_EQ(count(flat, p, CapturePhase::kRadiometry, PatternKind::kComb, 16.0), 8);  // a whole cycle
    EXPECT_EQ(count(flat, p, CapturePhase::kCorrespondence, PatternKind::kGray, 16.0), 40);
  }

  options.kind = SessionKind::kResponse;
  const CapturePlan response = *BuildPlan(options);
  for (int p = 0; p < 4; ++p) {
    EXPECT_EQ(count(response, p, CapturePhase::kRadiometry, PatternKind::kGrey, 16.0), 31);
    EXPECT_EQ(count(response, p, CapturePhase::kRadiometry, PatternKind::kWhite, 16.0), 4);
  }
}

}  // namespace
}  // namespace stratalux
