// SPDX-License-Identifier: Apache-2.0
// Each fault of the simulated devices, in each phase of a capture, in both sync modes: nothing that a complete or
// degraded session holds for proven shows another picture. The truth comes from the simulation, never from the capture.
#include "tests/firmware-host/soak/soak.h"

#include <algorithm>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

enum class Pace { kSerial, kOverlapped, kFreeRunning };

SoakOptions With(Pace pace, const FaultOptions& faults = {}) {
  SoakOptions options;
  options.plan = SmallPlan();
  options.plan.sync_mode = pace == Pace::kFreeRunning ? SyncMode::kFreeRunning : SyncMode::kTriggered;
  options.overlapped = pace == Pace::kOverlapped;
  options.faults = faults;
  return options;
}

std::string Reasons(const SoakCapture& capture) {
  std::string text;
  for (const std::string& reason : capture.report.Reasons()) text += reason + "\n";
  return text;
}

class Soak : public ::testing::TestWithParam<Pace> {};

TEST_P(Soak, ACleanCaptureIsCompleteAndRepeatable) {
  const SoakCapture once = CaptureOnce(With(GetParam())), again = CaptureOnce(With(GetParam()));
  EXPECT_EQ(once.report.status, SessionStatus::kComplete) << Reasons(once);
  EXPECT_EQ(once.report.FaultSummary(), "");
  EXPECT_TRUE(once.injected.empty());
  EXPECT_EQ(once.shots, again.shots);
  EXPECT_TRUE(once.mis_associated.empty());
}

// A marker, among the codes, the sinusoids, the sweep. Each kind of fault meets two of them, in the next pace the
// others.
constexpr int64_t kPlaces[] = {3, 15, 37, 46};

TEST_P(Soak, NoFaultPassesOffAFrameForAnother) {
  SoakTable table;
  for (int k = 0; k < kFaultKinds; ++k)
    for (int at = (k + static_cast<int>(GetParam())) % 2; at < 4; at += 2) {
      const int64_t place = kPlaces[at];
      const auto kind = static_cast<FaultKind>(k);
      const int64_t count = kind == FaultKind::kSyncStuck ? 2 : 1;
      const SoakCapture capture = CaptureOnce(With(GetParam(), {{{kind, place, count, 0.0}}, 1, 0.0, {}}));
      table.Add(capture);
      EXPECT_TRUE(capture.mis_associated.empty()) << ToString(kind) << " at " << place;
      // Six to eight periods of the sinusoids: their shifts differ by as much as a blink takes from one.
      const bool may_pass = kind == FaultKind::kLampBlink && place == 37;
      EXPECT_TRUE(may_pass || capture.changed_unsaid.empty())
          << ToString(kind) << " at " << place << ", step " << capture.changed_unsaid.front();
      ASSERT_FALSE(capture.injected.empty()) << ToString(kind) << " at " << place;
      EXPECT_EQ(capture.injected[0].kind, kind);
      EXPECT_EQ(capture.injected[0].number, place);
      const bool ends = kind == FaultKind::kCameraGone || kind >= FaultKind::kLinesGone;
      const bool lasts = kind == FaultKind::kSubjectMoved || kind == FaultKind::kLampDrift;
      const bool passes = kind == FaultKind::kSubjectSwayed || kind == FaultKind::kLampBlink;
      if (ends) {
        EXPECT_EQ(capture.report.status, SessionStatus::kFailed) << ToString(kind);
      } else if (passes) {  // whether it is seen at this size depends on the step; nothing is lost by it
        EXPECT_NE(capture.report.status, SessionStatus::kFailed) << ToString(kind) << " at " << place;
      } else if (lasts) {
        // During the pre-roll, one that is shot again after the change is sound.
        if (place > 8) {
          EXPECT_EQ(capture.report.status, SessionStatus::kDegraded) << ToString(kind) << " at " << place;
        }
      } else {
        EXPECT_EQ(capture.report.status, SessionStatus::kComplete)
            << ToString(kind) << " at " << place << ": " << Reasons(capture);
      }
    }
  table.Print();
}

// A bit's pulse steps twice, its inverse's frame is lost, and the memory that is loaded anew lags: shown is the
// inverse, then the bit, which add up as they should. In the top bit of rows nothing that follows would contradict.
TEST_P(Soak, ABitAndItsInverseAreNotTakenForEachOther) {
  const CapturePlan plan = *BuildPlan(With(GetParam()).plan);
  const auto bit = std::find_if(plan.steps.begin(), plan.steps.end(), [](const PlanStep& step) {
    return step.pattern.kind == PatternKind::kGray && step.pattern.axis == PatternAxis::kRows;
  });
  const int64_t pulse = bit->index;  // of the first projector: the pre-roll steps all four at once
  for (int64_t lag = 1; lag < 20; ++lag) {
    const FaultOptions faults = {{{FaultKind::kProjectorSkip, pulse, 1, 0.0},
                                  {FaultKind::kFrameLost, bit->index + 1, 1, 0.0},
                                  {FaultKind::kProjectorLag, pulse + 1 + lag, 1, 0.0}},
                                 1,
                                 0.0,
                                 {}};
    const SoakCapture capture = CaptureOnce(With(GetParam(), faults));
    EXPECT_TRUE(capture.mis_associated.empty()) << lag << " pulses later, step " << capture.mis_associated.front();
    EXPECT_EQ(capture.report.status, SessionStatus::kComplete) << Reasons(capture);
  }
}

// Capture `number` of soak-bursts of the night of that seed.
SoakOptions OfANight(uint64_t night, uint64_t number) {
  SoakOptions options = With(Pace::kOverlapped);
  options.seed = night + number % 7;
  options.faults.seed = night * 1000003 + number;
  options.faults.rate = 0.01;
  options.faults.burst = 4;
  options.faults.pair = 0.3;
  return options;
}

// Two bits of a code are given up, its memory stands two pictures on, and its load ends before a frame speaks that is
// no code. Other bits beside their own inverses add up as well.
TEST(SoakFound, ACodeThatNothingBearsOutDoesNotCount) {
  const SoakCapture capture = CaptureOnce(OfANight(20261130, 428));
  EXPECT_TRUE(capture.mis_associated.empty()) << capture.mis_associated.size();
  EXPECT_EQ(capture.report.status, SessionStatus::kDegraded);
}

// Rows of a logical code each show the next plane, but the last, which was shot again in step. What is decoded from
// that agrees with one shift of the sinusoid, and not with the others.
TEST(SoakFound, ALogicalCodeThatIsAPairAheadDoesNotCount) {
  SoakOptions options = OfANight(20261129, 530);
  options.plan.code = ColumnCode::kXor4;
  const SoakCapture capture = CaptureOnce(options);
  EXPECT_TRUE(capture.mis_associated.empty()) << capture.mis_associated.size();
  EXPECT_EQ(capture.report.status, SessionStatus::kDegraded);
}

TEST_P(Soak, TheInterlockIsTheReason) {
  const SoakCapture stopped = CaptureOnce(With(GetParam(), {{{FaultKind::kEmergencyStop, 50}}, 1, 0.0, {}}));
  EXPECT_THAT(Reasons(stopped), HasSubstr("emergency stop"));
  const SoakCapture opened = CaptureOnce(With(GetParam(), {{{FaultKind::kDoorOpen, 50}}, 1, 0.0, {}}));
  EXPECT_THAT(Reasons(opened), HasSubstr("door open"));
}

TEST_P(Soak, SomeThousandFramesOfRandomFaults) {
  SoakTable table;
  for (uint64_t n = 0; table.frames() < 2000; ++n) {
    SoakOptions options = With(GetParam(), {{}, 77 + n, 0.02, {}});
    options.seed = n;
    const SoakCapture capture = CaptureOnce(options);
    table.Add(capture);
    EXPECT_TRUE(capture.mis_associated.empty())
        << "fault seed " << 77 + n << ", first step " << capture.mis_associated.front() << ", session "
        << ToString(capture.report.status);
  }
  EXPECT_GE(table.complete(), table.captures() * 3 / 4);
}

// Beside faults of all kinds, frames that come within the learnt deadline or after it.
TEST_P(Soak, ByLearntDeadlinesALateFrameIsNeverTakenForAnother) {
  SoakTable table;
  int64_t late = 0;
  for (uint64_t n = 0; table.frames() < 2000; ++n) {
    SoakOptions options = With(GetParam(), {{}, 177 + n, 0.005, {}});
    options.seed = n;
    options.learnt = true;
    options.slow_rate = 0.01;
    const SoakCapture capture = CaptureOnce(options);
    table.Add(capture);
    late += !capture.learnt_held;
    EXPECT_TRUE(capture.mis_associated.empty())
        << "fault seed " << 177 + n << ", first step " << capture.mis_associated.front() << ", session "
        << ToString(capture.report.status);
  }
  table.Print();
  EXPECT_GE(table.complete(), table.captures() * 3 / 4);
  EXPECT_GE(late, table.captures() / 4) << "there were late frames";
}

std::string NameOf(const ::testing::TestParamInfo<Pace>& pace) {
  if (pace.param == Pace::kFreeRunning) return "FreeRunning";
  return pace.param == Pace::kOverlapped ? "Overlapped" : "Serial";
}

INSTANTIATE_TEST_SUITE_P(Modes, Soak, ::testing::Values(Pace::kSerial, Pace::kOverlapped, Pace::kFreeRunning), NameOf);

TEST(SoakBrackets, TheyCarryTheirExposure) {
  SoakOptions options = With(Pace::kSerial);
  options.plan.brackets = {1.0, 0.4};
  // Among the combs, where the exposure changes from frame to frame: the frame is as bright as the one before.
  const CapturePlan plan = *BuildPlan(options.plan);
  const auto comb = std::find_if(plan.steps.begin(), plan.steps.end(),
                                 [](const PlanStep& step) { return step.phase == CapturePhase::kSweep; });
  for (const int64_t place : {comb->index + 1, comb->index + 2, comb->index + 7, comb->index + 8}) {
    options.faults.script = {{FaultKind::kExposureLatch, place, 1, 0.0}};
    const SoakCapture capture = CaptureOnce(options);
    EXPECT_TRUE(capture.mis_associated.empty()) << place;
    EXPECT_EQ(capture.report.status, SessionStatus::kComplete) << place << ": " << Reasons(capture);
    EXPECT_GE(capture.report.Count(ShotFault::kWrongLevel), 1) << place;
  }
}

TEST(SoakBrackets, OfEveryPhaseCompleteUndisturbed) {
  // Black is darker in a short exposure and brighter in a long one; that is no fault.
  SoakOptions options = With(Pace::kSerial);
  options.faults = {};
  options.plan.brackets = {1.0, 2.0, 0.25};
  options.plan.reference_brackets = {1.0, 2.0};
  options.plan.correspondence_brackets = {1.0, 0.5};
  options.plan.separation_brackets = {1.0, 0.5};
  options.plan.spot_brackets = {1.0, 2.0};
  const SoakCapture capture = CaptureOnce(options);
  EXPECT_TRUE(capture.mis_associated.empty());
  EXPECT_EQ(capture.report.status, SessionStatus::kComplete) << Reasons(capture);
  EXPECT_EQ(capture.report.retried, 0) << capture.report.FaultSummary();
}

}  // namespace
}  // namespace stratalux::rig
