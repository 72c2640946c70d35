// SPDX-License-Identifier: Apache-2.0
// A subject who jumps: its projector is captured anew, and no wrong frame is taken for a right one by that.
#include <map>
#include <set>
#include <string>
#include <tuple>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/sequence/sequencer.h"
#include "tests/firmware-host/sequence/scripted_rig.h"

namespace stratalux::rig {
namespace {

// Far enough for the scene's light to contradict the white; two columns more, as many as the comb goes in a step.
constexpr int kJumpPx = 16;

struct RecordsOfJumps : FrameSink {
  Status Put(FrameRecord record, Image<uint16_t>) override {
    records.push_back(std::move(record));
    return Status::Ok();
  }
  std::vector<FrameRecord> records;
};

class SubjectJumpTest : public ::testing::Test {
 protected:
  SubjectJumpTest() : plan_(*BuildPlan(PlanOfScriptedRig())), rig_(2, 128, 64) {
    options_.shooter.wait = [this](std::chrono::nanoseconds time) { rig_.Advance(time); };
    options_.witness.read_noise_dn = 1.0;
  }

  CaptureReport Run() {
    sink_.records.clear();
    Result<CaptureReport> report = Sequencer(rig_.devices(), options_, logger_).Run(plan_, sink_);
    EXPECT_TRUE(report.ok()) << report.status().message();
    return report.ok() ? *report : CaptureReport();
  }
  [[nodiscard]] int StepOf(int projector, CapturePhase phase, int skip = 0) const {
    for (const PlanStep& step : plan_.steps)
      if (step.projector == projector && step.phase == phase && skip-- == 0) return step.index;
    return -1;
  }
  [[nodiscard]] int StepsOf(int projector) const {
    return static_cast<int>(std::ranges::count(plan_.steps, projector, &PlanStep::projector));
  }
  // Of the frames that count for what reads the store, those that show another picture than the record says; of steps
  // that the report calls missing none counts.
  [[nodiscard]] std::set<int> WrongSteps(const CaptureReport& report) const {
    std::map<int, const FrameRecord*> last;
    for (const FrameRecord& r : sink_.records)
      if (r.level_check != LevelCheck::kFailed) last[r.step] = &r;
    for (const int step : report.missing_steps) last.erase(step);
    std::set<int> wrong;
    for (const auto& [step, record] : last)
      for (const auto& [projector, pattern] : rig_.shown.at(record->driver_sequence))
        if (!(pattern == record->pattern)) wrong.insert(step);
    return wrong;
  }
  static int Moves(const CaptureReport& report, int projector) {
    return static_cast<int>(std::ranges::count_if(report.findings, [&](const Finding& f) {
      return f.kind == FindingKind::kMoved && f.projector == projector && f.step >= 0;
    }));
  }

  CapturePlan plan_;
  ScriptedRig rig_;
  SequencerOptions options_;
  Logger logger_{LogLevel::kError, stderr};
  RecordsOfJumps sink_;
};

TEST_F(SubjectJumpTest, AStillSubjectIsAskedForNoReference) {
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete);
  EXPECT_EQ(report.frames, report.planned);
  EXPECT_EQ(report.Count(ShotFault::kSubjectMoved), 0);
}

class JumpPlaceTest : public SubjectJumpTest, public ::testing::WithParamInterface<std::pair<CapturePhase, int>> {};

TEST_P(JumpPlaceTest, TheProjectorIsCapturedAnewAndTheNextGoesOn) {
  const int step = StepOf(0, GetParam().first, GetParam().second);
  rig_.jumps[step] = kJumpPx;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kDegraded);
  EXPECT_EQ(report.captured, report.planned) << report.Reasons().front();
  EXPECT_EQ(report.Count(ShotFault::kSubjectMoved), 1) << report.FaultSummary();
  EXPECT_EQ(Moves(report, 0), 1);
  EXPECT_EQ(Moves(report, 1), 0);
  EXPECT_THAT(WrongSteps(report), ::testing::IsEmpty());
  // All that counts of the projector was shot after the jump, one frame a step; of the other nothing was shot twice.
  std::map<int, const FrameRecord*> last;
  for (const FrameRecord& r : sink_.records) last[r.step] = &r;
  int again = 0;
  for (const auto& [at, record] : last) {
    EXPECT_EQ(record->retake_cause, record->retry == 0 ? "" : "subject moved") << at;
    EXPECT_TRUE(record->projector == 0 || record->retry == 0) << at;
    again += record->retry > 0;
  }
  EXPECT_GE(again, step - StepOf(0, CapturePhase::kReference));
  EXPECT_LE(report.frames, report.planned + StepsOf(0) + 10) << "the reference, and the tries at the group";
}

INSTANTIATE_TEST_SUITE_P(Places, JumpPlaceTest,
                         ::testing::Values(std::pair(CapturePhase::kCorrespondence, 6),   // between two pairs
                                           std::pair(CapturePhase::kCorrespondence, 7),   // between bit and inverse
                                           std::pair(CapturePhase::kCorrespondence, 19),  // of rows
                                           std::pair(CapturePhase::kSeparation, 2),       // in a set of shifts
                                           std::pair(CapturePhase::kSeparation, 4), std::pair(CapturePhase::kSweep, 0),
                                           std::pair(CapturePhase::kSweep, 7), std::pair(CapturePhase::kMotion, 0),
                                           std::pair(CapturePhase::kMotion, 3)));

TEST_F(SubjectJumpTest, AJumpAtTheReferenceHasTheReferenceShotAgain) {
  for (const int skip : {0, 1, 2}) {  // before white, before black, after both
    rig_.jumps = {{rig_.camera_triggers + StepOf(1, CapturePhase::kReference) + skip, kJumpPx}};
    const CaptureReport report = Run();
    EXPECT_EQ(report.captured, report.planned) << skip;
    EXPECT_THAT(WrongSteps(report), ::testing::IsEmpty()) << skip;
    EXPECT_LE(report.frames, report.planned + 10) << skip;
  }
}

TEST_F(SubjectJumpTest, TwoJumpsAreTwo) {
  rig_.jumps[StepOf(0, CapturePhase::kCorrespondence, 8)] = kJumpPx;
  rig_.jumps[rig_.camera_triggers + StepOf(0, CapturePhase::kSweep, 9) + 22] = -kJumpPx;
  const CaptureReport report = Run();
  EXPECT_EQ(report.captured, report.planned);
  EXPECT_EQ(report.Count(ShotFault::kSubjectMoved), 2) << report.FaultSummary();
  EXPECT_EQ(Moves(report, 0), 2);
  EXPECT_THAT(WrongSteps(report), ::testing::IsEmpty());
}

TEST_F(SubjectJumpTest, WhoNeverHoldsStillIsNotWaitedForForEver) {
  for (const int every : {3, 7, 15, 25, 40}) {
    rig_.jumps.clear();
    int way = kJumpPx;
    for (int n = 20; n < 3000; n += every, way = -way) rig_.jumps[rig_.camera_triggers + n] = way;
    const int64_t before = rig_.camera_triggers;
    const CaptureReport report = Run();
    EXPECT_NE(report.status, SessionStatus::kComplete) << every;
    EXPECT_FALSE(report.findings.empty()) << every;
    EXPECT_LE(report.Count(ShotFault::kSubjectMoved), options_.max_reference_asks) << every;
    // Three tries of each step, and of each that a jump had shot again.
    EXPECT_LE(rig_.camera_triggers - before, 3 * report.planned * (1 + options_.max_reference_asks)) << every;
    EXPECT_THAT(WrongSteps(report), ::testing::IsEmpty()) << every;
  }
}

// A frame from before the jump may not stand beside those from behind it, whatever becomes of its step.
TEST_F(SubjectJumpTest, WhatIsNotProvenAnewEndsTheCapture) {
  options_.max_reference_asks = 1;
  const int first = StepOf(0, CapturePhase::kCorrespondence, 8);
  rig_.jumps[first] = kJumpPx;
  rig_.jumps[2 * first + 16] = kJumpPx;
  const CaptureReport report = Run();
  EXPECT_EQ(report.Count(ShotFault::kSubjectMoved), 1);
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_TRUE(std::ranges::any_of(report.findings, [](const Finding& f) { return f.kind == FindingKind::kNoProof; }));
}

TEST_F(SubjectJumpTest, NoReferenceIsAskedBeyondTheBounds) {
  rig_.jumps[StepOf(0, CapturePhase::kCorrespondence, 8)] = kJumpPx;
  options_.max_reference_asks = 0;
  CaptureReport report = Run();
  EXPECT_EQ(report.Count(ShotFault::kSubjectMoved), 0);
  EXPECT_LT(report.captured, report.planned);
  options_.max_reference_asks = 6;
  options_.max_useless_time = std::chrono::nanoseconds(1);
  rig_.jumps = {{rig_.camera_triggers + StepOf(0, CapturePhase::kCorrespondence, 8), kJumpPx},
                {rig_.camera_triggers + StepOf(1, CapturePhase::kSweep, 8) + 20, kJumpPx}};
  report = Run();
  EXPECT_EQ(report.Count(ShotFault::kSubjectMoved), 1) << "the second came when the time was used up";
}

TEST_F(SubjectJumpTest, AProjectorThatStaysStuckIsTakenForNoJump) {
  // Whatever it is told, it shows what it showed then: alike at each try, in the reference's place, too.
  for (const auto& [phase, skip] : {std::pair(CapturePhase::kCorrespondence, 6), std::pair(CapturePhase::kMotion, 1),
                                    std::pair(CapturePhase::kReference, 2)}) {
    rig_.projector_trouble.clear();
    const int64_t begin = rig_.PulsesOf(0) + StepOf(0, CapturePhase::kReference) + 1;
    const int64_t from = phase == CapturePhase::kReference ? begin : rig_.PulsesOf(0) + StepOf(0, phase, skip);
    for (int64_t pulse = from; pulse < from + 4000; ++pulse)
      rig_.projector_trouble[{0, pulse}] = ProjectorTrouble::kStuck;
    const CaptureReport report = Run();
    EXPECT_EQ(report.Count(ShotFault::kSubjectMoved), 0) << ToString(phase);
    EXPECT_NE(report.status, SessionStatus::kComplete) << ToString(phase);
    if (report.status == SessionStatus::kFailed) continue;
    EXPECT_THAT(WrongSteps(report), ::testing::IsEmpty()) << ToString(phase);
  }
}

// A jump and a fault at once, before and behind each other, also in the shots that the jump makes necessary.
class JumpWithFaultTest : public SubjectJumpTest, public ::testing::WithParamInterface<std::tuple<int, int>> {};

TEST_P(JumpWithFaultTest, NoWrongFrameIsTakenForARightOne) {
  const auto [fault, distance] = GetParam();
  constexpr int kCameraTroubles = 8;
  // A comb behind its place, seen two columns aside, lies where it belongs.
  for (const auto& [phase, skip, jump] :
       {std::tuple(CapturePhase::kCorrespondence, 9, kJumpPx), std::tuple(CapturePhase::kSeparation, 1, -kJumpPx),
        std::tuple(CapturePhase::kSweep, 5, -kJumpPx)}) {
    const int step = StepOf(0, phase, skip);
    rig_.jumps = {{rig_.camera_triggers + step, jump}};
    rig_.camera_trouble.clear();
    rig_.projector_trouble.clear();
    if (fault < kCameraTroubles)
      rig_.camera_trouble[rig_.camera_triggers + step + distance] = static_cast<CameraTrouble>(fault);
    else
      rig_.projector_trouble[{0, rig_.PulsesOf(0) + step + distance}] =
          static_cast<ProjectorTrouble>(fault - kCameraTroubles);
    const CaptureReport report = Run();
    EXPECT_NE(report.status, SessionStatus::kFailed) << report.Reasons().front();
    EXPECT_THAT(WrongSteps(report), ::testing::IsEmpty()) << ToString(phase) << " " << jump;
  }
}

INSTANTIATE_TEST_SUITE_P(Each, JumpWithFaultTest,
                         ::testing::Combine(::testing::Range(0, 12), ::testing::Values(0, 1, 9)));

}  // namespace
}  // namespace stratalux::rig
