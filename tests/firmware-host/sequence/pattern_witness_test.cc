// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/pattern_witness.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

PlanOptions OneProjector() {
  PlanOptions options;
  options.projectors = 1;
  options.projector_width = 256;
  options.projector_height = 128;
  options.comb_period = 64;
  options.spot_pitch = 64;
  return options;
}

// A camera of 320x160 pixels that sees column 0.8 x and row 0.8 y, with half of the light spread by a box of
// 2 * kSpread + 1 projector pixels (scattering) and noise of a real sensor.
class WitnessTest : public ::testing::Test {
 protected:
  static constexpr int kSpread = 9;
  explicit WitnessTest(const PlanOptions& plan = OneProjector(), const WitnessOptions& options = {})
      : plan_(*BuildPlan(plan)), witness_(plan_, options) {
    witness_.StartProjector(0);
  }

  Image<uint16_t> See(const Pattern& pattern, double lamp = 1.0) {
    Image<uint16_t> frame(320, 160);
    for (int y = 0; y < frame.height(); ++y)
      for (int x = 0; x < frame.width(); ++x) {
        const int column = static_cast<int>(0.8 * x);
        const int row = static_cast<int>(0.8 * y);
        double wide = 0.0;
        for (int d = -kSpread; d <= kSpread; ++d) {
          const bool rows = pattern.axis == PatternAxis::kRows;
          wide +=
              pattern.Intensity(std::clamp(column + (rows ? 0 : d), 0, 255), std::clamp(row + (rows ? d : 0), 0, 127)) /
              (2.0 * kSpread + 1.0);
        }
        const bool subject = column >= first_column_ && column < first_column_ + subject_columns_;
        const double signal = !subject ? 0.0 : lamp * white_dn_ * (0.5 * pattern.Intensity(column, row) + 0.5 * wide);
        const double noise = std::sqrt(signal / 4.0 + 9.0) * random_.Normal();
        frame(x, y) = static_cast<uint16_t>(std::clamp(std::round(64.0 + signal + noise), 0.0, 4095.0));
      }
    return frame;
  }
  void Show(const PlanStep& step, const Image<uint16_t>& frame) { witness_.Add(step, frame, MeanDn(frame)); }
  // Shows every step up to `last` as planned.
  void ShowUpTo(int last) {
    for (const PlanStep& step : plan_.steps) {
      if (step.index > last) return;
      if (step.projector != 0) continue;
      Show(step, See(step.pattern));
      if (PatternWitness::GroupOf(plan_, step.index).back() != step.index) continue;
      ASSERT_NE(witness_.Check(step), LevelCheck::kFailed) << step.index << " " << step.pattern.ToString();
    }
  }
  void ShowPhases(const std::set<CapturePhase>& phases) {
    for (const PlanStep& step : plan_.steps) {
      if (step.projector != 0 || !phases.contains(step.phase)) continue;
      Show(step, See(step.pattern));
      if (PatternWitness::GroupOf(plan_, step.index).back() != step.index) continue;
      EXPECT_NE(witness_.Check(step), LevelCheck::kFailed) << step.index << " " << step.pattern.ToString();
    }
  }
  // Reference and codes of a projector begun anew, each as `shown` has it; steps that are refuted or doubted.
  std::vector<int> ShowCodes(const std::function<Pattern(const PlanStep&)>& shown) {
    witness_.StartProjector(0);
    std::vector<int> blamed;
    for (const PlanStep& step : plan_.steps) {
      if (step.projector != 0 || step.phase > CapturePhase::kCorrespondence) continue;
      Show(step, See(shown(step)));
      if (PatternWitness::GroupOf(plan_, step.index).back() != step.index) continue;
      if (witness_.Check(step) == LevelCheck::kFailed) blamed.push_back(step.index);
    }
    for (const int step : witness_.TakeDoubtful()) blamed.push_back(step);
    return blamed;
  }
  // Every step, under a lamp of its own, whatever is said of it; the reference is taken.
  void ShowAll(const std::function<double(const PlanStep&)>& lamp) {
    for (const PlanStep& step : plan_.steps) {
      if (step.projector != 0) continue;
      Show(step, See(step.pattern, lamp(step)));
      if (PatternWitness::GroupOf(plan_, step.index).back() != step.index) continue;
      const LevelCheck check = witness_.Check(step);
      if (step.phase == CapturePhase::kReference) {
        ASSERT_NE(check, LevelCheck::kFailed);
      }
    }
  }
  [[nodiscard]] const PlanStep& First(CapturePhase phase, int skip = 0) const {
    return *std::find_if(plan_.steps.begin(), plan_.steps.end(), [&](const PlanStep& step) {
      return step.projector == 0 && step.phase == phase && skip-- == 0;
    });
  }

  CapturePlan plan_;
  PatternWitness witness_;
  double white_dn_ = 1200.0;
  int first_column_ = 0, subject_columns_ = 256;  // that the subject stands in
  Random random_{5};
};

class EachCode : public WitnessTest, public ::testing::WithParamInterface<ColumnCode> {
 protected:
  EachCode() : WitnessTest(Plan()) {}
  static PlanOptions Plan() {
    PlanOptions options = OneProjector();
    options.code = GetParam();
    return options;
  }
};

TEST_P(EachCode, OfAnHonestProjectorPassesThroughout) {
  ShowUpTo(static_cast<int>(plan_.steps.size()));
  EXPECT_TRUE(witness_.CheckProjector().empty());
  EXPECT_THAT(witness_.TakeDoubtful(), ::testing::IsEmpty());
  EXPECT_THAT(witness_.UnborneCodes({}), ::testing::IsEmpty());
}

TEST_P(EachCode, LocatesCombs) {
  const PlanStep& first = First(CapturePhase::kSweep);
  ShowUpTo(first.index - 1);
  for (int wrong : {1, 2, 3, 6, 16, 30, 31}) {
    Pattern shown = first.pattern;
    shown.shift = wrong * plan_.options.comb_step;
    Show(first, See(shown));
    EXPECT_EQ(witness_.Check(first), LevelCheck::kFailed) << wrong;
  }
  Show(first, See(first.pattern));
  EXPECT_EQ(witness_.Check(first), LevelCheck::kPassed);
}

TEST_P(EachCode, OfABitExchangedWithItsInverseNoOtherIsBlamed) {
  int found = 0;
  for (int exchanged = 0; exchanged < 8; ++exchanged) {
    std::vector<int> wrong;
    const std::vector<int> blamed = ShowCodes([&](const PlanStep& step) {
      Pattern shown = step.pattern;
      if (shown.kind == PatternKind::kGray && shown.axis == PatternAxis::kColumns && shown.bit == exchanged) {
        shown.inverse = !shown.inverse;
        wrong.push_back(step.index);
      }
      return shown;
    });
    for (const int step : blamed) EXPECT_THAT(wrong, ::testing::Contains(step)) << "bit " << exchanged;
    found += !blamed.empty();
  }
  std::printf("%s: %d of 8 exchanged bits are found\n", ToString(GetParam()), found);
  EXPECT_GE(found, 5);
}

TEST_P(EachCode, FindsTheCombInWhichTheLampBlinked) {
  const int blinked = First(CapturePhase::kSweep, 12).index;
  ShowAll([&](const PlanStep& step) { return step.index == blinked ? 0.7 : 1.0; });
  const std::vector<Finding> findings = witness_.CheckProjector();
  ASSERT_EQ(findings.size(), 1U);
  EXPECT_EQ(findings[0].kind, FindingKind::kBlink);
  EXPECT_EQ(findings[0].step, blinked);
}

TEST_P(EachCode, ALampThatIsAFewPerCentWeakerInAPairRefutesNothing) {
  for (const int plane : {0, 3, 6}) {
    witness_.StartProjector(0);
    for (const PlanStep& step : plan_.steps) {
      if (step.projector != 0 || step.phase > CapturePhase::kCorrespondence) continue;
      const bool weaker = step.pattern.kind == PatternKind::kGray && step.pattern.bit == plane;
      Show(step, See(step.pattern, weaker ? 0.98 : 1.0));
      if (PatternWitness::GroupOf(plan_, step.index).back() != step.index) continue;
      EXPECT_NE(witness_.Check(step), LevelCheck::kFailed) << step.pattern.ToString();
    }
    const std::vector<int> doubtful = witness_.TakeDoubtful();
    for (const PlanStep& step : plan_.steps)
      if (step.pattern.kind == PatternKind::kGray && step.pattern.bit == plane) {
        EXPECT_THAT(doubtful, ::testing::Not(::testing::Contains(step.index)));
      }
  }
}

class WavesWitness : public WitnessTest {
 protected:
  WavesWitness() : WitnessTest(Plan()) {}
  static PlanOptions Plan() {
    PlanOptions options = OneProjector();
    options.code = ColumnCode::kMicroPhase;
    return options;
  }
};

// Both planes of a period exchanged with their inverses, or shown for each other.
TEST_F(WavesWitness, APeriodThatDisagreesWithAllOthersIsFound) {
  for (const bool exchanged : {true, false})
    for (int period = 0; period < 4; ++period) {
      std::vector<int> wrong;
      const std::vector<int> blamed = ShowCodes([&](const PlanStep& step) {
        Pattern shown = step.pattern;
        if (shown.kind == PatternKind::kGray && shown.axis == PatternAxis::kColumns && shown.bit / 2 == period) {
          if (exchanged)
            shown.inverse = !shown.inverse;
          else
            shown.bit ^= 1;
          wrong.push_back(step.index);
        }
        return shown;
      });
      EXPECT_FALSE(blamed.empty()) << exchanged << period;
      for (const int step : blamed) EXPECT_THAT(wrong, ::testing::Contains(step)) << exchanged << period;
    }
}

INSTANTIATE_TEST_SUITE_P(All, EachCode,
                         ::testing::Values(ColumnCode::kGray, ColumnCode::kXor2, ColumnCode::kXor4,
                                           ColumnCode::kMinStripe, ColumnCode::kMicroPhase));

TEST_F(WitnessTest, ABlackOrWhiteFrameInPlaceOfAGuardOrWhiteFails) {
  ShowUpTo(First(CapturePhase::kSweep).index - 1);
  const PlanStep& white = First(CapturePhase::kMotion);
  Show(white, See({.kind = PatternKind::kBlack}));
  EXPECT_EQ(witness_.Check(white), LevelCheck::kFailed);
  const PlanStep& guard = First(CapturePhase::kGuard);
  Show(guard, See({.kind = PatternKind::kWhite}));
  EXPECT_EQ(witness_.Check(guard), LevelCheck::kFailed);
}

TEST_F(WitnessTest, SwappedBitsBreakTheSumWithTheInverse) {
  const PlanStep& bit = First(CapturePhase::kCorrespondence, 4);
  ShowUpTo(bit.index - 1);
  Pattern shown = bit.pattern;
  shown.bit += 1;
  Show(bit, See(shown));
  const PlanStep& inverse = plan_.steps[bit.index + 1];
  Show(inverse, See(inverse.pattern));
  EXPECT_EQ(witness_.Check(inverse), LevelCheck::kFailed);
}

TEST_F(WitnessTest, ABitExchangedWithItsInverseIsDoubted) {
  // It adds up, but with it stretches of the picture run backwards. Every bit but the top one (a mirror image) and the
  // finest ones; a right one is not doubted.
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows})
    for (const int exchanged : {-1, 1, 2, 3, 4}) {
      witness_.StartProjector(0);
      std::vector<int> wrong;
      for (const PlanStep& step : plan_.steps) {
        if (step.projector != 0 || step.phase > CapturePhase::kCorrespondence) continue;
        Pattern shown = step.pattern;
        if (shown.kind == PatternKind::kGray && shown.axis == axis && shown.bit == exchanged) {
          shown.inverse = !shown.inverse;
          wrong.push_back(step.index);
        }
        Show(step, See(shown));
        if (PatternWitness::GroupOf(plan_, step.index).back() == step.index) {
          EXPECT_NE(witness_.Check(step), LevelCheck::kFailed);
        }
      }
      EXPECT_EQ(witness_.TakeDoubtful(), wrong) << "bit " << exchanged;
      if (wrong.empty()) continue;
      // Shot again, it is no better.
      for (int step : wrong) {
        Pattern shown = plan_.steps[step].pattern;
        shown.inverse = !shown.inverse;
        Show(plan_.steps[step], See(shown));
      }
      EXPECT_EQ(witness_.Check(plan_.steps[wrong.back()]), LevelCheck::kFailed);
      for (int step : wrong) Show(plan_.steps[step], See(plan_.steps[step].pattern));
      EXPECT_EQ(witness_.Check(plan_.steps[wrong.back()]), LevelCheck::kPassed);
    }
}

TEST_F(WitnessTest, SilenceIsDoubtedWhenItsLoadEndsBeforeAFrameSpeaks) {
  const PlanStep& bit = First(CapturePhase::kCorrespondence, 2);
  const PlanStep& inverse = plan_.steps[bit.index + 1];
  ShowUpTo(bit.index - 1);
  Show(bit, See(bit.pattern));  // half of a pair: nothing is said of it
  EXPECT_THAT(witness_.TakeDoubtful(), ::testing::IsEmpty());
  witness_.EndLoad();
  EXPECT_THAT(witness_.TakeDoubtful(), ::testing::ElementsAre(bit.index, inverse.index));
  Show(inverse, See(inverse.pattern));
  EXPECT_EQ(witness_.Check(inverse), LevelCheck::kPassed);
  EXPECT_THAT(witness_.TakeDoubtful(), ::testing::IsEmpty());
}

TEST_F(WitnessTest, SilenceIsTrustedWhenALaterFrameOfItsLoadSpeaks) {
  const PlanStep& silent = First(CapturePhase::kCorrespondence, 2);
  const PlanStep& bit = First(CapturePhase::kCorrespondence, 4);
  const PlanStep& inverse = plan_.steps[bit.index + 1];
  ShowUpTo(silent.index - 1);
  Show(silent, See(silent.pattern));
  Show(bit, See(bit.pattern));
  Show(inverse, See(inverse.pattern));
  EXPECT_EQ(witness_.Check(inverse), LevelCheck::kPassed);
  witness_.EndLoad();
  EXPECT_THAT(witness_.TakeDoubtful(), ::testing::IsEmpty());
}

TEST_F(WitnessTest, ADarkSceneHasNoReference) {
  for (int skip : {0, 1}) Show(First(CapturePhase::kReference, skip), See({.kind = PatternKind::kBlack}));
  EXPECT_EQ(witness_.Check(First(CapturePhase::kReference, 1)), LevelCheck::kFailed);
}

TEST_F(WitnessTest, ADimmerSweepDoesNotAddUp) {
  const PlanStep& first = First(CapturePhase::kSweep);
  ShowUpTo(first.index - 1);
  for (const PlanStep& step : plan_.steps)
    if (step.phase == CapturePhase::kSweep) Show(step, See(step.pattern, 0.8));
  const std::vector<Finding> findings = witness_.CheckProjector();
  ASSERT_EQ(findings.size(), 1U);
  EXPECT_EQ(findings[0].kind, FindingKind::kLamp);
  EXPECT_NEAR(findings[0].value, 0.8, 0.02);
}

// The nominal exposure need not be the first of a comb's exposures.
class NominalSecond : public WitnessTest {
 protected:
  NominalSecond() : WitnessTest(Plan()) {}
  static PlanOptions Plan() {
    PlanOptions options = OneProjector();
    options.brackets = {0.5, 1.0};
    return options;
  }
};

TEST_F(NominalSecond, ADimmerSweepIsFound) {
  ShowAll([this](const PlanStep& step) {
    return (step.phase == CapturePhase::kSweep ? 0.8 : 1.0) * step.exposure_ms / plan_.options.exposure_ms;
  });
  const std::vector<Finding> findings = witness_.CheckProjector();
  ASSERT_EQ(findings.size(), 1U);
  EXPECT_EQ(findings[0].kind, FindingKind::kLamp);
  EXPECT_NEAR(findings[0].value, 0.8, 0.02);
}

// Dark skin in faint light: the cycle takes the noise of one black off as often as it has frames.
class FaintLight : public WitnessTest {
 protected:
  FaintLight() : WitnessTest(OneProjector(), Options()) {}
  static WitnessOptions Options() {
    WitnessOptions options;
    options.min_contrast_dn = 4.0;
    options.read_noise_dn = 3.0;
    return options;
  }
};

// Fewer photons than tell black from spots: neither is called wrong, nor doubted for want of a word; other pictures
// are.
TEST_F(FaintLight, SpotsAndGuardsThatDrownInNoiseAreNotRefuted) {
  for (const double white_dn : {12.0, 20.0, 40.0})
    for (int capture = 0; capture < 3; ++capture) {
      white_dn_ = white_dn;
      witness_.StartProjector(0);
      for (const PlanStep& step : plan_.steps) {
        if (step.projector != 0 || step.phase == CapturePhase::kSweep || step.phase == CapturePhase::kRepeat) continue;
        Show(step, See(step.pattern));
        if (PatternWitness::GroupOf(plan_, step.index).back() != step.index) continue;
        const LevelCheck check = witness_.Check(step);
        if (step.phase == CapturePhase::kReference || step.phase == CapturePhase::kSpot ||
            step.phase == CapturePhase::kGuard) {
          EXPECT_NE(check, LevelCheck::kFailed) << white_dn << " DN, " << step.pattern.ToString();
        }
      }
      const PlanStep &guard = First(CapturePhase::kGuard), &spot = First(CapturePhase::kSpot);
      witness_.EndLoad();
      for (const int step : witness_.TakeDoubtful())
        EXPECT_TRUE(step != guard.index && step != spot.index) << white_dn << " DN, " << step;
      for (const PlanStep* step : {&guard, &spot})
        for (const CapturePhase other : {CapturePhase::kReference, CapturePhase::kSeparation}) {
          Show(*step, See(First(other).pattern));
          EXPECT_EQ(witness_.Check(*step), LevelCheck::kFailed)
              << white_dn << " DN, " << First(other).pattern.ToString();
        }
    }
}

// A subject narrower than a period has more of one shift than of another; that is no lamp.
TEST_F(WitnessTest, ANarrowSubjectIsNoLampThatBlinked) {
  for (const PlanStep& step : plan_.steps)
    if (step.projector == 0 && step.phase == CapturePhase::kSeparation && step.pattern.axis == PatternAxis::kColumns &&
        6 * step.pattern.period <= 256)
      subject_columns_ = 2 * step.pattern.period / 3;
  first_column_ = 100;
  ASSERT_LT(subject_columns_, 256) << "no fine stripes in this plan";
  ShowPhases({CapturePhase::kReference, CapturePhase::kCorrespondence, CapturePhase::kSeparation});
}

// No spot falls on it: frames of spots are black, and that is no fault.
TEST_F(WitnessTest, ASubjectBetweenTheSpotsRefutesNone) {
  first_column_ = 44;  // discs of radius 4 about 32 and 96
  subject_columns_ = 44;
  ShowPhases({CapturePhase::kReference, CapturePhase::kCorrespondence, CapturePhase::kSpot, CapturePhase::kGuard,
              CapturePhase::kRepeat});
}

// What no check tells from black is doubted after all when its load was out of step elsewhere.
TEST_F(FaintLight, SilentSpotsOfALoadThatWasRefutedAreDoubted) {
  for (const bool refuted : {false, true}) {
    white_dn_ = 20.0;
    witness_.StartProjector(0);
    ShowPhases({CapturePhase::kReference, CapturePhase::kCorrespondence});
    witness_.EndLoad();
    const PlanStep &spot = First(CapturePhase::kSpot), &guard = First(CapturePhase::kGuard);
    Show(spot, See(spot.pattern));
    EXPECT_EQ(witness_.Check(spot), LevelCheck::kNotChecked);
    Show(guard, See(refuted ? First(CapturePhase::kReference).pattern : guard.pattern));
    EXPECT_EQ(witness_.Check(guard), refuted ? LevelCheck::kFailed : LevelCheck::kNotChecked);
    witness_.EndLoad();
    const std::vector<int> doubtful = witness_.TakeDoubtful();
    EXPECT_EQ(std::count(doubtful.begin(), doubtful.end(), spot.index), refuted ? 1 : 0);
  }
}

TEST_F(FaintLight, TheNoiseOfTheBlackIsNoLampAndALampIs) {
  int lamps = 0, dimmer = 0;
  for (const double white_dn : {12.0, 30.0})
    for (int capture = 0; capture < 4; ++capture)
      for (const double lamp : {1.0, 0.3}) {
        white_dn_ = white_dn;
        witness_.StartProjector(0);
        ShowAll([lamp](const PlanStep& step) { return step.phase == CapturePhase::kSweep ? lamp : 1.0; });
        const std::vector<Finding> findings = witness_.CheckProjector();
        const bool found = std::any_of(findings.begin(), findings.end(),
                                       [](const Finding& f) { return f.kind == FindingKind::kLamp; });
        (lamp == 1.0 ? lamps : dimmer) += found;
      }
  EXPECT_EQ(lamps, 0);
  EXPECT_EQ(dimmer, 8);
}

TEST_F(WitnessTest, ACombInAnothersPlaceIsMixedUpThoughTheMeanAddsUp) {
  const PlanStep& first = First(CapturePhase::kSweep);
  ShowUpTo(first.index - 1);
  const int wrong = first.index + 9;
  for (const PlanStep& step : plan_.steps) {
    if (step.phase != CapturePhase::kSweep) continue;
    Pattern shown = step.pattern;
    if (step.index == wrong) shown.shift = (shown.shift + 14) % shown.period;
    Show(step, See(shown));
  }
  const std::vector<Finding> findings = witness_.CheckProjector();
  ASSERT_EQ(findings.size(), 1U) << ::testing::PrintToString(ToText(findings));
  EXPECT_EQ(findings[0].kind, FindingKind::kMixedUp);
  EXPECT_EQ(findings[0].step, wrong);
}

TEST_F(WitnessTest, AWhiteThatDiffersIsTheLampOrTheVisitorAtOnce) {
  const PlanStep& white = First(CapturePhase::kMotion);
  ShowUpTo(white.index);
  EXPECT_FALSE(witness_.CheckWhite(white).has_value());
  Show(white, See(white.pattern, 0.85));
  ASSERT_TRUE(witness_.CheckWhite(white).has_value());
  EXPECT_EQ(witness_.CheckWhite(white)->kind, FindingKind::kLamp);
  Image<uint16_t> moved = See(white.pattern);
  for (int y = 0; y < moved.height(); ++y)
    for (int x = 0; x < 40; ++x) moved(x, y) = static_cast<uint16_t>(64 + (moved(x, y) - 64) * 9 / 10);
  Show(white, moved);
  ASSERT_TRUE(witness_.CheckWhite(white).has_value());
  EXPECT_EQ(witness_.CheckWhite(white)->kind, FindingKind::kMoved);
}

}  // namespace
}  // namespace stratalux::rig
