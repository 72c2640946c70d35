// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/sequencer.h"

#include <algorithm>
#include <map>
#include <set>
#include <thread>
#include <tuple>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/sequence/visit_time.h"
#include "shared/base/random.h"
#include "tests/firmware-host/sequence/scripted_rig.h"

namespace stratalux::rig {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::IsSupersetOf;

class KeepingSink : public FrameSink {
 public:
  Status Put(FrameRecord record, Image<uint16_t> pixels) override {
    if (fail_after >= 0 && static_cast<int>(records.size()) >= fail_after) return Status::Failed("disk full");
    records.push_back(std::move(record));
    EXPECT_EQ(static_cast<size_t>(records.back().width) * records.back().height, pixels.size());
    return Status::Ok();
  }
  [[nodiscard]] std::vector<FrameRecord> ShotsOf(int step) const {
    std::vector<FrameRecord> shots;
    for (const FrameRecord& r : records)
      if (r.step == step) shots.push_back(r);
    return shots;
  }
  std::vector<FrameRecord> records;
  int fail_after = -1;
};

// Counts what it is told, and may end the capture.
class CountingObserver : public CaptureObserver {
 public:
  Status BeforeShot(const PlanStep& step, int /*retry*/) override {
    ++shots;
    if (step.index == throw_before) throw std::bad_alloc();
    return step.index == end_before ? Status::Failed("the visitor left") : Status::Ok();
  }
  void OnFault(const PlanStep& step, ShotFault fault) override { faults.emplace_back(step.index, fault); }
  void OnStepDone(const PlanStep& /*step*/) override { ++steps; }
  void OnFrame(const FrameRecord& record, const Image<uint16_t>& pixels) override {
    frames += pixels.size() > 0 && record.mean_dn > 0.0;
    shown.insert({record.step, record.retry});
  }
  Status OnFinding(const Finding& finding) override {
    findings.push_back(finding);
    return end_at_finding ? Status::Failed("not worth going on") : Status::Ok();
  }
  std::vector<std::pair<int, ShotFault>> faults;
  std::multiset<std::pair<int, int>> shown;  // step and retry
  std::vector<Finding> findings;
  int shots = 0, steps = 0, frames = 0;
  int end_before = -1, throw_before = -1;
  bool end_at_finding = false;
};

class SequencerTest : public ::testing::Test {
 protected:
  SequencerTest() : plan_(*BuildPlan(PlanOfScriptedRig())), rig_(2, 128, 64) {
    options_.shooter.wait = [this](std::chrono::nanoseconds time) { rig_.Advance(time); };
    // The scripted camera has little noise; its optics leave a sixth of the finest stripes' contrast.
    options_.witness.read_noise_dn = 1.0;
  }

  CaptureReport Run() {
    Sequencer sequencer(rig_.devices(), options_, logger_, &observer_);
    Result<CaptureReport> report = sequencer.Run(plan_, sink_);
    EXPECT_TRUE(report.ok()) << report.status().message();
    EXPECT_THAT(rig_.lit(), IsEmpty()) << "a lamp stayed on";
    EXPECT_FALSE(rig_.camera_running);
    return report.ok() ? *report : CaptureReport();
  }
  // First step of a projector's phase.
  [[nodiscard]] int StepOf(int projector, CapturePhase phase, int skip = 0) const {
    for (const PlanStep& step : plan_.steps)
      if (step.projector == projector && step.phase == phase && skip-- == 0) return step.index;
    return -1;
  }
  // With no trouble before it, a step's camera trigger has the step's number.
  void ExpectHealed(const CaptureReport& report, ShotFault fault, int step) {
    EXPECT_EQ(report.status, SessionStatus::kComplete) << (report.Reasons().empty() ? "" : report.Reasons().front());
    EXPECT_EQ(report.Count(fault), 1) << report.FaultSummary();
    EXPECT_EQ(report.captured, report.planned);
    const int again_from = PatternWitness::OneLoadOf(plan_, step).front();
    EXPECT_EQ(report.retried, step - again_from + 1);
    EXPECT_EQ(rig_.trusting_loads, plan_.options.projectors) << "a reload trusted the memory's count";
    ASSERT_FALSE(sink_.ShotsOf(step).empty());
    EXPECT_EQ(sink_.ShotsOf(step).back().retry, 1);
    for (const FrameRecord& r : sink_.records)
      EXPECT_LE(r.retry, r.step >= again_from && r.step <= step ? 1 : 0) << r.step;
  }

  void Overlap() {
    rig_.overlapped = true;
    options_.shooter.camera.read_out = ReadOut::kOverlapped;
    options_.shooter.camera.min_frame_period = std::chrono::milliseconds(17);
  }
  // Of a complete session: no step's frame shows another step's pattern.
  void ExpectEveryFrameShowsItsPattern() {
    std::map<int, const FrameRecord*> last;
    for (const FrameRecord& r : sink_.records)
      if (r.level_check != LevelCheck::kFailed) last[r.step] = &r;
    ASSERT_EQ(last.size(), plan_.steps.size());
    for (const auto& [step, record] : last)
      for (const auto& [projector, pattern] : rig_.shown.at(record->driver_sequence))
        EXPECT_EQ(pattern, record->pattern) << "step " << step << ", projector " << projector;
  }

  CapturePlan plan_;
  ScriptedRig rig_;
  SequencerOptions options_;
  Logger logger_{LogLevel::kError, stderr};
  KeepingSink sink_;
  CountingObserver observer_;
};

TEST_F(SequencerTest, AHealthyRigGivesOneProvenFrameAStep) {
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete) << (report.Reasons().empty() ? "" : report.Reasons().front());
  EXPECT_EQ(report.captured, static_cast<int>(plan_.steps.size()));
  EXPECT_EQ(report.FaultSummary(), "");
  EXPECT_EQ(observer_.steps, report.planned);
  EXPECT_EQ(observer_.shots, report.planned);
  EXPECT_EQ(observer_.frames, report.frames);
  EXPECT_THAT(observer_.faults, IsEmpty());
  ASSERT_EQ(sink_.records.size(), plan_.steps.size());
  std::set<int64_t> sequences;
  for (size_t i = 0; i < sink_.records.size(); ++i) {
    const FrameRecord& r = sink_.records[i];
    EXPECT_EQ(r.step, static_cast<int>(i));
    EXPECT_EQ(r.pattern, plan_.steps[i].pattern);
    EXPECT_GT(r.sync_time, MonotonicNs{});
    EXPECT_LT(r.sync_time, r.trigger_time);
    EXPECT_LT(r.trigger_time, r.frame_time);
    EXPECT_EQ(r.driver_sequence, 100 + r.step);
    EXPECT_EQ(r.trigger_number, 2 * r.step + 1);  // the bank counts the projectors' pulses, too
    EXPECT_NE(r.level_check, LevelCheck::kFailed) << i << " " << r.pattern.ToString();
    sequences.insert(r.driver_sequence);
  }
  EXPECT_EQ(sequences.size(), plan_.steps.size());
  EXPECT_EQ(rig_.loads, 2);
  EXPECT_EQ(rig_.torn_exposures, 0) << "a projector moved on while the camera exposed";
  EXPECT_EQ(rig_.early_triggers, 0) << "the camera was triggered while it read out";
  ExpectEveryFrameShowsItsPattern();
}

TEST_F(SequencerTest, ACameraThatOverlapsIsTriggeredWhileItReadsOut) {
  const CaptureReport serial = Run();
  const auto serial_took = sink_.records.back().trigger_time - sink_.records.front().trigger_time;
  sink_.records.clear();
  Overlap();
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete) << (report.Reasons().empty() ? "" : report.Reasons().front());
  EXPECT_EQ(report.FaultSummary(), "");
  EXPECT_EQ(rig_.torn_exposures, 0) << "a projector moved on while the camera exposed";
  EXPECT_EQ(rig_.early_triggers, 0) << "the camera was triggered while it exposed";
  ExpectEveryFrameShowsItsPattern();
  // 8 ms of read-out a frame, less what settling takes anyway.
  const auto took = sink_.records.back().trigger_time - sink_.records.front().trigger_time;
  EXPECT_LT(took, serial_took - report.planned * std::chrono::milliseconds(3));
}

TEST_F(SequencerTest, AVisitTakesAsLongAsItsEstimateSays) {
  rig_.pulse_time = std::chrono::nanoseconds(0);
  for (const bool overlapped : {false, true}) {
    if (overlapped) Overlap();
    VisitTiming timing;
    timing.settle = options_.shooter.settle;
    timing.camera = options_.shooter.camera;
    timing.transfer = std::chrono::milliseconds(8);
    const MonotonicNs begin = rig_.devices().light.Now();
    EXPECT_EQ(Run().status, SessionStatus::kComplete);
    const auto took = static_cast<double>((rig_.devices().light.Now() - begin).count());
    EXPECT_NEAR(static_cast<double>(VisitTime(plan_, timing).count()) / took, 1.0, 0.02) << overlapped;
  }
}

TEST_F(SequencerTest, AFrameExposedWhileTheProjectorMovedOnIsLate) {
  // The scripted camera begins 0.05 ms after its trigger.
  options_.shooter.camera.exposure_margin = std::chrono::nanoseconds(0);
  rig_.pulse_time = std::chrono::nanoseconds(0);
  const CaptureReport report = Run();
  EXPECT_NE(report.status, SessionStatus::kComplete);
  EXPECT_GE(report.Count(ShotFault::kLateFrame), 1);
  EXPECT_GE(rig_.torn_exposures, 1);
}

TEST_F(SequencerTest, ASpoiltStepIsShotAgainBeforeTheSequenceGoesOn) {
  // Its frame would have told whether the memory is in step: it is loaded anew.
  Overlap();
  for (const int skip : {2, 5, 9}) rig_.camera_trouble[StepOf(0, CapturePhase::kSweep, skip)] = CameraTrouble::kLose;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete) << (report.Reasons().empty() ? "" : report.Reasons().front());
  EXPECT_GE(report.Count(ShotFault::kLostFrame), 2) << report.FaultSummary();
  EXPECT_EQ(rig_.loads, 2 + report.retried);
  ExpectEveryFrameShowsItsPattern();
  int before = -1;
  for (const FrameRecord& r : sink_.records) {
    EXPECT_GE(r.step, before);
    before = r.step;
  }
}

class TroubledPipelineTest : public SequencerTest, public ::testing::WithParamInterface<std::tuple<bool, int>> {};

TEST_P(TroubledPipelineTest, NoFrameIsTakenForAnothers) {
  const auto [overlapped, trouble] = GetParam();
  if (overlapped) Overlap();
  // Three troubles somewhere, the last of them twice in a row; apart, so that none meets a third try.
  Random random(overlapped ? 1 : 2, trouble);
  const int last = static_cast<int>(plan_.steps.size()) - 1, stretch = (last - 8) / 3;
  for (int k = 0; k < 3; ++k) {
    const int at = 8 + k * stretch + static_cast<int>(random.Uniform(0.0, 1.0) * (stretch - 4));
    if (trouble < 8) {
      rig_.camera_trouble[at] = static_cast<CameraTrouble>(trouble);
      // Frames that come after the next trigger spoil the third try, too.
      if (k == 2 && rig_.camera_trouble[at] != CameraTrouble::kDeliverAfter)
        rig_.camera_trouble[at + 1] = static_cast<CameraTrouble>(trouble);
    } else {
      rig_.projector_trouble[{k % 2, 8 + (at % (last / 2))}] = static_cast<ProjectorTrouble>(trouble - 8);
    }
  }
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete) << (report.Reasons().empty() ? "" : report.Reasons().front());
  EXPECT_NE(report.FaultSummary(), "");
  ExpectEveryFrameShowsItsPattern();
  // A camera that exposes late exposes while the projector moves on.
  if (static_cast<CameraTrouble>(trouble) != CameraTrouble::kLate) {
    EXPECT_EQ(rig_.torn_exposures, 0);
  }
}

INSTANTIATE_TEST_SUITE_P(Each, TroubledPipelineTest, ::testing::Combine(::testing::Bool(), ::testing::Range(0, 12)));

TEST_F(SequencerTest, EveryCodeSinusoidAndCombFrameIsChecked) {
  Run();
  for (const FrameRecord& r : sink_.records) {
    if (r.pattern.kind == PatternKind::kSpots) continue;
    EXPECT_EQ(r.level_check, LevelCheck::kPassed) << r.step << " " << r.pattern.ToString();
  }
}

TEST_F(SequencerTest, ALostFrameIsShotAgain) {
  const int step = StepOf(0, CapturePhase::kSweep, 3);
  rig_.camera_trouble[step] = CameraTrouble::kLose;
  ExpectHealed(Run(), ShotFault::kLostFrame, step);
  EXPECT_EQ(sink_.ShotsOf(step).size(), 1U);
}

TEST_F(SequencerTest, AnIgnoredCameraTriggerIsALostFrame) {
  const int step = StepOf(1, CapturePhase::kCorrespondence, 1);
  rig_.camera_trouble[step] = CameraTrouble::kIgnore;
  ExpectHealed(Run(), ShotFault::kLostFrame, step);
}

TEST_F(SequencerTest, AGapInTheDriversNumbersIsShotAgain) {
  const int step = StepOf(0, CapturePhase::kSeparation, 2);
  rig_.camera_trouble[step] = CameraTrouble::kSkipNumber;
  ExpectHealed(Run(), ShotFault::kSequenceGap, step);
}

TEST_F(SequencerTest, ARepeatedBufferIsADoubledFrame) {
  const int step = StepOf(0, CapturePhase::kSweep, 5);
  rig_.camera_trouble[step] = CameraTrouble::kRepeat;
  ExpectHealed(Run(), ShotFault::kDoubledFrame, step);
}

TEST_F(SequencerTest, ASecondExposureIsADoubledFrame) {
  const int step = StepOf(0, CapturePhase::kCorrespondence, 4);
  rig_.camera_trouble[step] = CameraTrouble::kExtra;
  ExpectHealed(Run(), ShotFault::kDoubledFrame, step);
}

TEST_F(SequencerTest, TheLastFrameOfAProjectorCanBeDoubledToo) {
  const int step = StepOf(1, CapturePhase::kGuard, 1);
  rig_.camera_trouble[step] = CameraTrouble::kExtra;
  ExpectHealed(Run(), ShotFault::kDoubledFrame, step);
}

TEST_F(SequencerTest, ALateFrameIsShotAgain) {
  const int step = StepOf(0, CapturePhase::kSpot);
  rig_.camera_trouble[step] = CameraTrouble::kLate;
  ExpectHealed(Run(), ShotFault::kLateFrame, step);
}

TEST_F(SequencerTest, ACorruptFrameIsShotAgain) {
  const int step = StepOf(1, CapturePhase::kSweep);
  rig_.camera_trouble[step] = CameraTrouble::kCorrupt;
  ExpectHealed(Run(), ShotFault::kCorruptFrame, step);
}

TEST_F(SequencerTest, SwappedFramesNeverChangePlaces) {
  // The frame of one step arrives after the frame of the next trigger.
  const int step = StepOf(0, CapturePhase::kSweep, 8);
  rig_.camera_trouble[step] = CameraTrouble::kDeliverAfter;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete);
  EXPECT_EQ(report.Count(ShotFault::kLostFrame), 1);
  EXPECT_EQ(report.Count(ShotFault::kOutOfOrder), 1);
  // What counts for the step was exposed after the step's last trigger and before the next one.
  for (const FrameRecord& r : sink_.records) {
    EXPECT_GE(r.frame_time, r.trigger_time);
    EXPECT_LE(r.frame_time - r.trigger_time, std::chrono::milliseconds(36));
  }
}

TEST_F(SequencerTest, AMissingSyncEdgeRewindsTheMemory) {
  const int step = StepOf(0, CapturePhase::kCorrespondence, 7);
  rig_.projector_trouble[{0, step}] = ProjectorTrouble::kNoEdge;
  ExpectHealed(Run(), ShotFault::kMissingSync, step);
}

TEST_F(SequencerTest, AnIgnoredPulseRewindsTheMemory) {
  const int step = StepOf(0, CapturePhase::kReference);
  rig_.projector_trouble[{0, step}] = ProjectorTrouble::kIgnore;
  ExpectHealed(Run(), ShotFault::kMissingSync, step);
}

TEST_F(SequencerTest, ADoubleStepIsSeenByItsSecondEdge) {
  const int step = StepOf(0, CapturePhase::kSweep, 2);
  rig_.projector_trouble[{0, step}] = ProjectorTrouble::kDoubleStep;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete);
  EXPECT_GE(report.Count(ShotFault::kExtraSync), 1);
  EXPECT_EQ(report.captured, report.planned);
}

class WrongPatternTest : public SequencerTest, public ::testing::WithParamInterface<std::pair<CapturePhase, int>> {};

TEST_P(WrongPatternTest, AStuckPictureWithAllEdgesInPlaceIsSeenInTheImage) {
  // From this pulse on the projector runs one pattern behind: only the pictures can tell.
  const int step = StepOf(0, GetParam().first, GetParam().second);
  rig_.projector_trouble[{0, step}] = ProjectorTrouble::kStuck;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete) << (report.Reasons().empty() ? "" : report.Reasons().front());
  EXPECT_GE(report.Count(ShotFault::kWrongLevel), 1);
  bool failed_once = false;
  for (const FrameRecord& r : sink_.records) failed_once |= r.level_check == LevelCheck::kFailed;
  EXPECT_TRUE(failed_once);
  ExpectEveryFrameShowsItsPattern();
}

INSTANTIATE_TEST_SUITE_P(Phases, WrongPatternTest,
                         ::testing::Values(std::pair(CapturePhase::kReference, 1),
                                           std::pair(CapturePhase::kCorrespondence, 0),
                                           std::pair(CapturePhase::kCorrespondence, 3),
                                           std::pair(CapturePhase::kCorrespondence, 17),
                                           std::pair(CapturePhase::kSeparation, 1), std::pair(CapturePhase::kSpot, 0),
                                           std::pair(CapturePhase::kMotion, 0), std::pair(CapturePhase::kRepeat, 0),
                                           std::pair(CapturePhase::kRepeat, 1), std::pair(CapturePhase::kGuard, 0)));

TEST_F(SequencerTest, ACombInThePlaceOfSpotsIsSeen) {
  // With the sweep over rows a comb stands before the second spots.
  PlanOptions options = PlanOfScriptedRig();
  options.row_sweep = true;
  plan_ = *BuildPlan(options);
  const int step = StepOf(0, CapturePhase::kRepeat, 1);
  ASSERT_EQ(plan_.steps[step].pattern.kind, PatternKind::kSpots);
  ASSERT_EQ(plan_.steps[step - 1].pattern.kind, PatternKind::kComb);
  rig_.projector_trouble[{0, step}] = ProjectorTrouble::kStuck;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete) << (report.Reasons().empty() ? "" : report.Reasons().front());
  EXPECT_GE(report.Count(ShotFault::kWrongLevel), 1);
  ExpectEveryFrameShowsItsPattern();
}

TEST_F(SequencerTest, AProjectorThatNeverShowsTheCodeDegradesTheSession) {
  const int first = StepOf(0, CapturePhase::kCorrespondence, 2);
  // The next step is on show before the pair is judged: three pulses a try.
  for (int i = 0; i < 3; ++i) rig_.projector_trouble[{0, first + 1 + 3 * i}] = ProjectorTrouble::kStuck;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kDegraded);
  EXPECT_THAT(report.missing_steps, IsSupersetOf({first, first + 1}));
  ASSERT_FALSE(report.Reasons().empty());
  EXPECT_THAT(report.Reasons(), Contains(HasSubstr("level check failed")));
}

// The pair is refuted twice; at the last try one of its frames is lost, so that nothing judges the other.
TEST_F(SequencerTest, WhatWasRefutedIsNotProvenByTheLossOfItsPartner) {
  const int first = StepOf(0, CapturePhase::kCorrespondence, 2);
  for (int i = 0; i < 3; ++i) rig_.projector_trouble[{0, first + 1 + 3 * i}] = ProjectorTrouble::kStuck;
  rig_.camera_trouble[first + 4] = CameraTrouble::kLose;
  const CaptureReport report = Run();
  EXPECT_EQ(report.Count(ShotFault::kLostFrame), 1);
  EXPECT_EQ(report.status, SessionStatus::kDegraded);
  EXPECT_THAT(report.missing_steps, IsSupersetOf({first, first + 1}));
}

TEST_F(SequencerTest, AStepThatFailsThreeTimesIsNamedAndTheRestGoesOn) {
  const int step = StepOf(0, CapturePhase::kSweep, 4);
  for (int i = 0; i < 3; ++i) rig_.camera_trouble[step + i] = CameraTrouble::kCorrupt;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kDegraded);
  EXPECT_THAT(report.missing_steps, ElementsAre(step));
  EXPECT_EQ(report.captured, report.planned - 1);
  EXPECT_EQ(report.Count(ShotFault::kCorruptFrame), 3);
  ASSERT_EQ(report.Reasons().size(), 1U);
  EXPECT_THAT(report.Reasons()[0], HasSubstr("step " + std::to_string(step)));
}

// What tells one comb from another is the code: without it, faults that make up for each other would pass.
TEST_F(SequencerTest, WithoutACodeNothingThatItTellsIsProven) {
  const int code = StepOf(0, CapturePhase::kCorrespondence, 2);
  for (int i = 0; i < 3; ++i) rig_.camera_trouble[code + i] = CameraTrouble::kCorrupt;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kDegraded);
  const std::set<int> missing(report.missing_steps.begin(), report.missing_steps.end());
  for (const PlanStep& step : plan_.steps) {
    const bool by_columns = step.pattern.axis == PatternAxis::kColumns || !step.pattern.IsOneDimensional();
    const bool told = step.phase == CapturePhase::kSeparation || step.phase == CapturePhase::kSweep;
    const bool pair = step.index == code || step.index == code + 1;
    if (step.projector == 0 && (pair || (told && by_columns))) {
      EXPECT_TRUE(missing.contains(step.index)) << step.index << " " << step.pattern.ToString();
    } else if (step.projector != 0 || step.phase == CapturePhase::kMotion || !by_columns) {
      EXPECT_FALSE(missing.contains(step.index)) << step.index << " " << step.pattern.ToString();
    }
  }
}

TEST_F(SequencerTest, AShiftedPrerollAbortsWithTheShift) {
  rig_.preroll_offset = 1;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("shifted by 1 frame"));
  EXPECT_EQ(rig_.camera_triggers, 3 * 8);  // it may have been chance: shot again, twice
}

TEST_F(SequencerTest, ALostMarkerRepeatsTheWholePreroll) {
  rig_.camera_trouble[3] = CameraTrouble::kLose;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete);
  EXPECT_EQ(sink_.records[0].retry, 1);
  EXPECT_EQ(static_cast<int>(sink_.records.size()), report.planned);
}

TEST_F(SequencerTest, ADeadCameraEndsTheCaptureSoon) {
  rig_.camera_dead_from = 40;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("shots in a row"));
  EXPECT_LE(rig_.camera_triggers, 40 + options_.max_useless_shots + 1);
}

TEST_F(SequencerTest, WithoutItsReferenceAProjectorIsNotGoneOnWith) {
  const int step = StepOf(0, CapturePhase::kReference, 1);
  for (int i = 0; i < 3; ++i) rig_.camera_trouble[step + i] = CameraTrouble::kCorrupt;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("without this reference"));
  EXPECT_EQ(rig_.camera_triggers, step + 3);
}

TEST_F(SequencerTest, AReferenceThatNeverShowsEndsTheCapture) {
  // Black and all that follows would be held against nothing.
  const int white = StepOf(0, CapturePhase::kReference);
  for (int pulse = white; pulse < white + 40; ++pulse) rig_.projector_trouble[{0, pulse}] = ProjectorTrouble::kStuck;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("without this reference"));
  EXPECT_LE(rig_.camera_triggers, white + 2 * 3 + 1);
}

TEST_F(SequencerTest, EdgesThatNeverEndEndTheCapture) {
  // A line that chatters: an edge more after each loading.
  rig_.on_load = [this] {
    if (rig_.camera_triggers > 20) rig_.Ring(1);
  };
  rig_.projector_trouble[{0, 25}] = ProjectorTrouble::kIgnore;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("shots in a row"));
  EXPECT_LE(rig_.loads, 40);
}

TEST_F(SequencerTest, WhatNeverSpeaksIsAskedForNothing) {
  PlanOptions options = PlanOfScriptedRig();
  options.kind = SessionKind::kDark;
  plan_ = *BuildPlan(options);
  const int step = static_cast<int>(plan_.steps.size()) / 2;
  rig_.camera_trouble[step] = CameraTrouble::kLose;
  const CaptureReport report = Run();
  EXPECT_EQ(report.captured, report.planned);
  EXPECT_EQ(report.retried, 1);
}

TEST_F(SequencerTest, AFailedCaptureHandsOnWhatWaitedForItsGroup) {
  // Of a pair the first is here when the lines go.
  const int step = StepOf(0, CapturePhase::kCorrespondence, 2);
  rig_.on_camera_trigger = [this, step](int64_t trigger) {
    if (trigger == step + 1) rig_.interlock = StopReason::kLinesGone;
  };
  EXPECT_EQ(Run().status, SessionStatus::kFailed);
  ASSERT_EQ(sink_.ShotsOf(step).size(), 1U);
  EXPECT_EQ(sink_.ShotsOf(step)[0].level_check, LevelCheck::kNotChecked);
}

TEST_F(SequencerTest, AnUnknownClockIsRefused) {
  rig_.clock = ClockSource::kUnknown;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("unknown clock"));
}

TEST_F(SequencerTest, StopSwitchesTheLightsOffBeforeTheNextShot) {
  rig_.on_camera_trigger = [this](int64_t trigger) {
    if (trigger == 20) rig_.stop.Request(StopReason::kOperator);
  };
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_EQ(report.Reasons().front(), "interrupted");
  EXPECT_EQ(rig_.camera_triggers, 21);
  EXPECT_FALSE(rig_.ever_lit().empty());
}

TEST_F(SequencerTest, AnObserverSeesFaultsAndFindingsAsTheyComeUp) {
  const int step = StepOf(0, CapturePhase::kSweep, 4);
  for (int i = 0; i < 3; ++i) rig_.camera_trouble[step + i] = CameraTrouble::kCorrupt;
  const CaptureReport report = Run();
  EXPECT_THAT(observer_.faults,
              ElementsAre(std::pair(step, ShotFault::kCorruptFrame), std::pair(step, ShotFault::kCorruptFrame),
                          std::pair(step, ShotFault::kCorruptFrame)));
  EXPECT_THAT(observer_.findings, ElementsAre(Finding{FindingKind::kNoProof, 0, step}));
  EXPECT_EQ(report.findings, observer_.findings);
  EXPECT_EQ(report.Found().faults, (std::map<std::string, int64_t>{{"corrupt frame", 3}}));
  EXPECT_EQ(observer_.steps, report.planned) << "a step that was given up is done, too";
}

TEST_F(SequencerTest, AnObserverEndsTheCaptureBeforeTheNextShot) {
  observer_.end_before = StepOf(1, CapturePhase::kSweep);
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  ASSERT_EQ(report.findings.size(), 1U);
  EXPECT_EQ(report.findings[0], (Finding{FindingKind::kStopped, -1, observer_.end_before, 0, 0, "the visitor left"}));
  EXPECT_EQ(rig_.camera_triggers, observer_.end_before);
}

TEST_F(SequencerTest, AnExceptionPassesInTheDark) {
  observer_.throw_before = StepOf(1, CapturePhase::kSweep);
  Sequencer sequencer(rig_.devices(), options_, logger_, &observer_);
  EXPECT_THROW(static_cast<void>(sequencer.Run(plan_, sink_)), std::bad_alloc);
  EXPECT_THAT(rig_.lit(), IsEmpty());
  EXPECT_FALSE(rig_.camera_running);
  observer_.throw_before = -1;
  EXPECT_EQ(Run().status, SessionStatus::kComplete) << "and the rig serves the next one";
}

TEST_F(SequencerTest, ALostCaptureEndsAtOnceWhereTheObserverWantsIt) {
  rig_.lamp_drift = 0.003;
  observer_.end_at_finding = true;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_EQ(report.findings.front().kind, FindingKind::kStopped);
  EXPECT_EQ(report.findings.front().detail, "not worth going on");
  ASSERT_EQ(observer_.findings.size(), 1U);
  EXPECT_THAT(report.findings, Contains(observer_.findings[0])) << "what ended it is stored with it";
  EXPECT_LT(report.captured, report.planned * 3 / 4) << "the other projector was not begun";
}

TEST_F(SequencerTest, AFailingSinkEndsTheCaptureWithItsReason) {
  sink_.fail_after = 30;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("disk full"));
}

TEST_F(SequencerTest, WhereverTheSinkFailsAnObserverSeesEachFrameOnceAndWhole) {
  for (sink_.fail_after = 0; sink_.fail_after < 40; ++sink_.fail_after) {
    sink_.records.clear();
    observer_ = {};
    const CaptureReport report = Run();
    EXPECT_THAT(report.Reasons(), Contains(HasSubstr("disk full")));
    EXPECT_EQ(static_cast<size_t>(observer_.frames), observer_.shown.size()) << "an empty one at " << sink_.fail_after;
    EXPECT_EQ(std::set(observer_.shown.begin(), observer_.shown.end()).size(), observer_.shown.size());
  }
}

TEST_F(SequencerTest, AnOpenInterlockEndsTheCaptureWithItsName) {
  for (const StopReason cause : {StopReason::kEmergencyStop, StopReason::kDoorOpen, StopReason::kLinesGone}) {
    rig_.interlock = StopReason::kNone;
    ASSERT_TRUE(rig_.devices().light.Reset().ok());
    const int64_t before = rig_.camera_triggers;
    rig_.on_camera_trigger = [this, cause, before](int64_t trigger) {
      if (trigger == before + 30) rig_.interlock = cause;
    };
    const CaptureReport report = Run();
    EXPECT_EQ(report.status, SessionStatus::kFailed);
    EXPECT_THAT(report.Reasons().front(), HasSubstr(ToString(cause)));
    EXPECT_EQ(rig_.camera_triggers, before + 31) << "no shot after the button";
  }
}

TEST_F(SequencerTest, AReferenceThatWasWrongIsShotAgain) {
  // White comes out as the black marker before it; black is Gray bit 0 and so on: one behind from the start.
  rig_.projector_trouble[{0, StepOf(0, CapturePhase::kReference, 1)}] = ProjectorTrouble::kStuck;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kComplete);
  EXPECT_GE(report.Count(ShotFault::kWrongLevel), 1);
}

TEST_F(SequencerTest, AStuckCombIsShotAgainAloneOrWithThoseThatCouldNotTell) {
  // From this pulse on the combs are one step behind, until the next frame that speaks.
  for (const int skip : {1, 7, 12}) {
    const int step = StepOf(0, CapturePhase::kSweep, skip);
    rig_.projector_trouble.clear();
    rig_.projector_trouble[{0, rig_.PulsesOf(0) + step}] = ProjectorTrouble::kStuck;
    const CaptureReport report = Run();
    EXPECT_EQ(report.status, SessionStatus::kComplete) << skip;
    EXPECT_GE(report.Count(ShotFault::kWrongLevel), 1) << skip;
    EXPECT_LE(report.retried, 3) << skip;
  }
}

TEST_F(SequencerTest, ADeviceThatHangsLosesItsLight) {
  bool dark = false;
  rig_.on_camera_trigger = [&](int64_t trigger) {
    if (trigger != 20) return;
    rig_.Advance(options_.LongestStep(16.0) + std::chrono::milliseconds(1));
    for (int i = 0; i < 500 && !rig_.lit().empty(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    dark = rig_.lit().empty();
  };
  const CaptureReport report = Run();
  EXPECT_TRUE(dark) << "the lights burned while the camera hung";
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("no progress"));
}

TEST_F(SequencerTest, AMemoryIsReloadedInTheDark) {
  // Of a silent camera every shot is taken again.
  rig_.camera_trouble[40] = CameraTrouble::kLose;
  int loads_with_light = 0;
  rig_.on_load = [&] { loads_with_light += static_cast<int>(!rig_.lit().empty()); };
  EXPECT_EQ(Run().status, SessionStatus::kComplete);
  EXPECT_GE(rig_.loads, 3) << "nothing was reloaded";
  EXPECT_EQ(loads_with_light, 0);
}

TEST_F(SequencerTest, TheOnTimeLimitEndsTheCapture) {
  options_.max_on_time = std::chrono::milliseconds(300);
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kFailed);
  EXPECT_THAT(report.Reasons().front(), HasSubstr("on for as long as it may be"));
}

TEST_F(SequencerTest, ADriftingLampIsNamed) {
  rig_.lamp_drift = 0.003;
  const CaptureReport report = Run();
  EXPECT_EQ(report.status, SessionStatus::kDegraded);
  EXPECT_THAT(report.Reasons(), Contains(HasSubstr("of the reference's light")));
}

TEST_F(SequencerTest, OnlyTheProjectorOfTheStepIsLit) {
  std::vector<std::set<int>> lit;
  rig_.on_camera_trigger = [&](int64_t) { lit.push_back(rig_.lit()); };
  Run();
  for (const PlanStep& step : plan_.steps)
    EXPECT_EQ(lit[step.index], step.projector < 0 ? (std::set<int>{0, 1}) : std::set<int>{step.projector});
}

TEST_F(SequencerTest, APlanOfAnotherSizeIsRefusedBeforeAnyLight) {
  plan_.options.projector_width = 256;
  Sequencer sequencer(rig_.devices(), options_, logger_);
  const Result<CaptureReport> report = sequencer.Run(plan_, sink_);
  EXPECT_EQ(report.status().code(), StatusCode::kUsage);
  EXPECT_TRUE(rig_.ever_lit().empty());
}

// Of a projector with a gamma a wave and its inverse do not add up to white, and no frame of the code could be proven.
TEST_F(SequencerTest, WavesOfAProjectorThatIsNotLinearAreRefusedBeforeAnyLight) {
  plan_.options.code = ColumnCode::kMicroPhase;
  options_.witness.sinusoid_mean = {0.5, 0.48};
  const auto report = Sequencer(rig_.devices(), options_, logger_).Run(plan_, sink_);
  EXPECT_EQ(report.status().code(), StatusCode::kUsage);
  EXPECT_THAT(report.status().message(),
              ::testing::HasSubstr("code 'micro-phase' needs projectors of linear response"));
  EXPECT_THAT(report.status().message(), ::testing::HasSubstr("projector 1"));
  EXPECT_TRUE(rig_.ever_lit().empty());
}

TEST_F(SequencerTest, FreeRunningIsRefusedBeforeAnyLight) {
  plan_.options.sync_mode = SyncMode::kFreeRunning;
  Sequencer sequencer(rig_.devices(), options_, logger_);
  EXPECT_EQ(sequencer.Run(plan_, sink_).status().code(), StatusCode::kUsage);
  EXPECT_TRUE(rig_.ever_lit().empty());
}

}  // namespace
}  // namespace stratalux::rig
