// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/capture_watch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware-host/kiosk/lit_rectangle.h"

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;

Image<uint16_t> Lit(int left, int right, uint16_t level) { return LitRectangle(left, 48, right, 216, level); }

FrameRecord Reference(int projector, PatternKind kind) {
  FrameRecord record;
  record.phase = CapturePhase::kReference;
  record.projector = projector;
  record.pattern.kind = kind;
  return record;
}

Foreground Before() {
  const Image<uint16_t> white = Lit(80, 240, 1000);
  const std::vector<PreScan> scans = {{white, kDarkPicture}};
  return *ForegroundOf(scans, 3.0);
}

class CaptureWatchTest : public ::testing::Test {
 protected:
  void Shown(int projector, const Image<uint16_t>& white) {
    watch_.OnFrame(Reference(projector, PatternKind::kBlack), kDarkPicture);
    watch_.OnFrame(Reference(projector, PatternKind::kWhite), white);
  }
  [[nodiscard]] CaptureFacts Facts(const std::vector<FindingKind>& kinds = {},
                                   SessionStatus status = SessionStatus::kComplete) const {
    CaptureReport report;
    report.status = status;
    for (const FindingKind kind : kinds) report.findings.push_back({kind});
    return watch_.Facts(report, false);
  }
  std::vector<int> told_;
  CaptureWatch watch_{Before(), ExposureRule{}, 250, [this](int done, int /*of*/) { told_.push_back(done); }};
};

TEST_F(CaptureWatchTest, CoversWhatAllProjectorsLightTogether) {
  Shown(0, Lit(80, 160, 1000));
  EXPECT_EQ(Facts().coverage_permille, 500);
  Shown(1, Lit(160, 240, 800));
  EXPECT_EQ(Facts().coverage_permille, 1000);
}

TEST_F(CaptureWatchTest, CountsTheSaturatedOfTheBrightestProjector) {
  Image<uint16_t> glare = Lit(80, 240, 1000);
  for (int y = 48; y < 216; ++y)
    for (int x = 80; x < 96; ++x) glare(x, y) = 4095;  // a tenth
  Shown(0, Lit(80, 240, 1000));
  EXPECT_EQ(Facts().saturated_permille, 0);
  Shown(1, glare);
  Shown(2, Lit(80, 240, 1000));
  EXPECT_EQ(Facts().saturated_permille, 100);
}

// The room's light flashed over the first try: it was refused and shot again.
TEST_F(CaptureWatchTest, ARefusedReferenceSaysNothing) {
  FrameRecord refused = Reference(0, PatternKind::kWhite);
  refused.level_check = LevelCheck::kFailed;
  watch_.OnFrame(Reference(0, PatternKind::kBlack), kDarkPicture);
  watch_.OnFrame(refused, Lit(80, 240, 4095));
  EXPECT_EQ(Facts().saturated_permille, 0);
  EXPECT_EQ(Facts().coverage_permille, 0);
  Shown(0, Lit(80, 160, 1000));
  EXPECT_EQ(Facts().saturated_permille, 0);
  EXPECT_EQ(Facts().coverage_permille, 500);
}

TEST_F(CaptureWatchTest, AnotherPhaseAndAnotherBracketAreNoReference) {
  FrameRecord white = Reference(0, PatternKind::kWhite);
  watch_.OnFrame(Reference(0, PatternKind::kBlack), kDarkPicture);
  white.bracket = 1;
  watch_.OnFrame(white, Lit(80, 240, 4095));
  white.bracket = 0;
  white.phase = CapturePhase::kMotion;
  watch_.OnFrame(white, Lit(80, 240, 4095));
  EXPECT_EQ(Facts().saturated_permille, 0);
}

TEST_F(CaptureWatchTest, EveryFindingOfACaptureIsOneOfTheGates) {
  Shown(0, Lit(80, 240, 1000));
  EXPECT_EQ(Facts(), CaptureFacts());
  for (const FindingKind kind :
       {FindingKind::kPreroll, FindingKind::kSilentRig, FindingKind::kNoProof, FindingKind::kWrongPattern,
        FindingKind::kProofReused, FindingKind::kTriggersUnmatched})
    EXPECT_TRUE(Facts({kind}).unproven) << ToString(kind);
  EXPECT_TRUE(Facts({FindingKind::kLamp}).lamp);
  EXPECT_TRUE(Facts({FindingKind::kBlink}).lamp);
  EXPECT_TRUE(Facts({FindingKind::kMixedUp}).mixed_up);
  EXPECT_TRUE(Facts({FindingKind::kMoved}).moved);
  EXPECT_EQ(Facts({}, SessionStatus::kDegraded).worth, CaptureFacts::Worth::kDegraded);
  EXPECT_EQ(Facts({}, SessionStatus::kFailed).worth, CaptureFacts::Worth::kFailed);
}

TEST_F(CaptureWatchTest, TellsEachPercentOnce) {
  for (int step = 0; step < 10; ++step) watch_.OnStepDone({});
  EXPECT_THAT(told_, ElementsAre(3, 5, 8, 10));
}

}  // namespace
}  // namespace stratalux::rig
