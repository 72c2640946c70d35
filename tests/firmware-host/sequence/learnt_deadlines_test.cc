// SPDX-License-Identifier: Apache-2.0
// Captures by the deadlines that a selftest of the same rig learnt: what a lost frame costs on the rig's clock, and
// what becomes of a rig that is slower than it was.
#include <algorithm>
#include <iostream>
#include <span>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/projector/memory_layout.h"
#include "firmware-host/projector/memory_way.h"
#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/simulation_file.h"
#include "tests/firmware-host/sequence/learnt_rig.h"

namespace stratalux::rig {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

class NoSink : public FrameSink {
 public:
  Status Put(FrameRecord, Image<uint16_t>) override { return Status::Ok(); }
};

struct Taken {
  CaptureReport report;
  double seconds = 0.0;  // of the rig's clock
};

class LearntDeadlinesTest : public ::testing::Test {
 protected:
  [[nodiscard]] SimulatedRigOptions Rig(const CapturePlan& plan) const {
    SimulatedRigOptions options;
    options.scene = scene_;
    options.camera_width = width_;
    options.camera_height = width_ * 3 / 4;
    options.projector_width = plan.options.projector_width;
    options.projector_height = plan.options.projector_height;
    options.scattering = false;
    options.free_running = plan_.sync_mode == SyncMode::kFreeRunning;
    options.devices.timing = timing_;
    options.memories = LayOutMemories(plan.options)->Patterns();
    return options;
  }
  void Learn() {
    const CapturePlan plan = *BuildPlan(plan_);
    const Result<RigDelays> delays = LearnDelays(Rig(plan), plan, logger_);
    ASSERT_TRUE(delays.ok()) << delays.status().message();
    delays_ = *delays;
    learnt_ = DeadlinesFrom(*delays, kLongest);
  }
  Taken Take(const std::vector<Fault>& faults = {}) {
    const CapturePlan plan = *BuildPlan(plan_);
    SimulatedRigOptions options = Rig(plan);
    options.faults.script = faults;
    const auto rig = SimulatedRig::Create(options, logger_);
    EXPECT_TRUE(rig.ok()) << rig.status().message();
    SequencerOptions sequencer;
    sequencer.shooter.camera = CameraTimingOf(timing_, {});
    sequencer.shooter.sync_deadline = sequencer.shooter.frame_deadline = kLongest;
    sequencer.shooter.learnt = learnt_;
    sequencer.shooter.wait = [&](std::chrono::nanoseconds time) { (*rig)->Sleep(time); };
    StopToken stop;
    const auto light = GuardLight(**rig, stop);
    EXPECT_TRUE(light.ok()) << light.status().message();
    NoSink sink;
    const MonotonicNs start = (*rig)->clock().Now();
    const auto report =
        Sequencer({**light, (*rig)->lines(), (*rig)->camera(), (*rig)->projectors()}, sequencer, logger_)
            .Run(plan, sink);
    EXPECT_TRUE(report.ok()) << report.status().message();
    return {*report, 1e-9 * static_cast<double>(((*rig)->clock().Now() - start).count())};
  }
  // From RESET to where a step of the plan and what follows it lie nearest.
  [[nodiscard]] double SteppingTo(int step) const {
    const CapturePlan plan = *BuildPlan(plan_);
    const int projector = plan.steps[step].projector;
    size_t before = 0;
    for (int i = 0; i < step; ++i) before += plan.steps[i].projector < 0 || plan.steps[i].projector == projector;
    const std::vector<Pattern> sequence = SequenceOf(plan, projector);
    const MemoryTiming timing{FromMilliseconds(timing_.memory_step_ms), FromMilliseconds(timing_.memory_reset_ms)};
    const auto way = FindWay(LayOutMemories(plan_)->Patterns()[projector], std::span(sequence).subspan(before),
                             std::nullopt, timing);
    EXPECT_TRUE(way) << step;
    return way ? 1e-9 * static_cast<double>(TimeOf(*way, timing).count()) : 0.0;
  }
  // What two lost frames cost beyond the memories' steps. Nothing is exposed behind either, so that the exposures are
  // counted as the steps are, but for those that are taken again: a lost step, and what its load must show before it.
  double CostOfTwoLost(int first, int second) {
    const double healthy = Take().seconds;
    const CapturePlan plan = *BuildPlan(plan_);
    const int from_first = PatternWitness::OneLoadOf(plan, first).front();
    const int from_second = PatternWitness::OneLoadOf(plan, second).front();
    const int again = first - from_first + 1;
    const Taken taken = Take({{FaultKind::kFrameLost, first}, {FaultKind::kFrameLost, second + again}});
    EXPECT_EQ(taken.report.status, SessionStatus::kComplete) << taken.report.FaultSummary();
    EXPECT_EQ(taken.report.Count(ShotFault::kLostFrame), 2) << taken.report.FaultSummary();
    EXPECT_EQ(taken.report.retried, again + second - from_second + 1);
    EXPECT_TRUE(taken.report.slow.empty()) << "what is lost is not late";
    return taken.seconds - healthy - SteppingTo(from_first) - SteppingTo(from_second);
  }
  void ExpectCheapLosses(const char* what, int first, int second) {
    timing_.memory_reset_ms = 50.0;
    timing_.memory_step_ms = 4.0;
    Learn();
    const double learnt = CostOfTwoLost(first, second);
    learnt_.reset();
    const double configured = CostOfTwoLost(first, second);
    std::cout << what << ": two lost frames cost " << learnt << " s by learnt deadlines, " << configured
              << " s by the configured ones\n";
    EXPECT_LE(learnt, 0.3);
    EXPECT_GT(learnt, 0.0);
    EXPECT_GT(configured, 0.9) << "the ablation: each is awaited for 500 ms";
  }
  // A small visit, where the pictures do not matter.
  void SmallVisit() {
    plan_.projector_width = 64;
    plan_.projector_height = 48;
    plan_.comb_period = 16;
    plan_.spot_pitch = 16;
    plan_.spot_radius = 2;
    plan_.motion_whites = 3;
    width_ = 64;
  }
  static void ExpectSaid(const CaptureReport& report, const std::string& part) {
    std::string all;
    for (const SlowAnswers& slow : report.slow) all += SlowAnswersAsText(slow) + "\n";
    EXPECT_THAT(all, HasSubstr(part));
    EXPECT_THAT(all, HasSubstr("run `stratalux-rig selftest` again"));
  }

  static constexpr std::chrono::nanoseconds kLongest = milliseconds(500);  // as configured
  PlanOptions plan_;
  std::string scene_ = "head";
  int width_ = 232;
  RigTiming timing_;
  RigDelays delays_;
  std::optional<LearntDeadlines> learnt_;
  Logger logger_{LogLevel::kError};
};

// Steps of projector 0 of the default visit behind which nothing is exposed before their frame is here.
int LastBeforeSweep(const CapturePlan& plan) {
  const auto sweep = std::find_if(plan.steps.begin(), plan.steps.end(), [](const PlanStep& step) {
    return step.projector == 0 && (step.phase == CapturePhase::kSweep || step.phase == CapturePhase::kMotion);
  });
  return static_cast<int>(sweep - plan.steps.begin()) - 1;
}
int LastOfProjector(const CapturePlan& plan) {
  int last = -1;
  for (const PlanStep& step : plan.steps)
    if (step.projector == 0) last = step.index;
  return last;
}

TEST_F(LearntDeadlinesTest, TwoLostFramesThatNoNextOneTellsCostLittleInADefaultVisit) {
  const auto overlapped = LoadSimulation(STRATALUX_SOURCE_DIR "/docs/examples/scenes/overlapped.toml");
  ASSERT_TRUE(overlapped.ok());
  timing_ = overlapped->devices.timing;
  const CapturePlan plan = *BuildPlan(plan_);
  ExpectCheapLosses("overlapped", LastBeforeSweep(plan), LastOfProjector(plan));
}

TEST_F(LearntDeadlinesTest, TwoLostFramesOfASerialCameraCostLittleInADefaultVisit) {
  ExpectCheapLosses("serial", 21, 301);
}

TEST_F(LearntDeadlinesTest, ASelftestSeesTheDelaysOfTheRig) {
  SmallVisit();
  timing_.jitter_us = 100.0;
  Learn();
  ASSERT_EQ(delays_.sync.size(), 4U);
  for (const DelayFigures& sync : delays_.sync) {
    EXPECT_GE(sync.count, 60);
    EXPECT_NEAR(sync.median_ms, timing_.sync_delay_ms, 0.05);
    EXPECT_NEAR(sync.spread_ms, 0.1, 0.04);
    EXPECT_GT(sync.worst_ms, timing_.sync_delay_ms + 0.1);
    EXPECT_LT(sync.worst_ms, timing_.sync_delay_ms + 0.6);
  }
  EXPECT_EQ(delays_.frame.count, 60);
  EXPECT_NEAR(delays_.frame.median_ms, timing_.shutter_delay_ms + timing_.readout_ms, 0.1);
  EXPECT_NEAR(delays_.transfer_ms, timing_.readout_ms, 0.1);
  EXPECT_NEAR(delays_.frame_period_ms, 16.0 + timing_.readout_ms, 0.1);
  const Taken taken = Take();
  EXPECT_EQ(taken.report.status, SessionStatus::kComplete);
  EXPECT_EQ(taken.report.retried, 0);
  EXPECT_TRUE(taken.report.slow.empty()) << SlowAnswersAsText(taken.report.slow.front());
}

TEST_F(LearntDeadlinesTest, ALostEdgeIsNotAwaitedForHalfASecond) {
  SmallVisit();
  Learn();
  const std::vector<Fault> lost = {{FaultKind::kEdgeLost, 30}};
  const double learnt = Take(lost).seconds - Take().seconds;
  learnt_.reset();
  const double configured = Take(lost).seconds - Take().seconds;
  EXPECT_LT(learnt, 0.15);
  EXPECT_GT(configured, 0.45);
}

// The first answers of a capture tell: nothing is taken again.
TEST_F(LearntDeadlinesTest, ASlowerRigIsProvenWithoutARetakeAndSaysSo) {
  SmallVisit();
  for (const bool overlapped : {false, true}) {
    timing_ = {};
    timing_.overlapped_readout = overlapped;
    Learn();
    timing_.sync_delay_ms += 8.0;
    timing_.readout_ms = 15.0;
    const Taken taken = Take();
    EXPECT_EQ(taken.report.status, SessionStatus::kComplete) << taken.report.FaultSummary();
    EXPECT_EQ(taken.report.retried, 0) << taken.report.FaultSummary();
    ExpectSaid(taken.report, "SYNC of projector 3 came 8.4 ms or more after TRIGGER, beyond the 1.4 ms");
    ExpectSaid(taken.report, "frames came 15.0 ms or more after the exposure");
  }
}

// Far beyond the learnt deadlines, whatever the place of a late edge among the pulses.
TEST_F(LearntDeadlinesTest, AMuchSlowerRigIsProvenAsWell) {
  SmallVisit();
  Learn();
  for (const double sync_ms : {50.0, 97.0, 99.0, 120.0, 150.0, 250.0, 450.0}) {
    timing_ = {};
    timing_.sync_delay_ms = sync_ms;
    timing_.readout_ms = sync_ms;
    const Taken taken = Take();
    EXPECT_EQ(taken.report.status, SessionStatus::kComplete) << sync_ms << ": " << taken.report.FaultSummary();
    EXPECT_EQ(taken.report.retried, 0) << sync_ms << ": " << taken.report.FaultSummary();
    ExpectSaid(taken.report, "SYNC of projector 0");
  }
}

// From one exposure to the next: what had been given up comes after all, once, and the configured deadlines hold.
TEST_F(LearntDeadlinesTest, ARigThatTurnsSlowDuringACaptureCostsAFewRetakes) {
  SmallVisit();
  for (const bool overlapped : {false, true})
    for (const double slow_ms : {20.0, 25.0, 26.0, 30.0, 60.0, 200.0, 450.0}) {
      timing_ = {};
      timing_.overlapped_readout = overlapped;
      Learn();
      const Taken taken = Take({{FaultKind::kFrameSlow, 60, 1000, slow_ms}});
      EXPECT_EQ(taken.report.status, SessionStatus::kComplete) << slow_ms << ": " << taken.report.FaultSummary();
      EXPECT_LE(taken.report.retried, 2) << slow_ms << ": " << taken.report.FaultSummary();
      ExpectSaid(taken.report, "frames came ");
    }
}

TEST_F(LearntDeadlinesTest, OneLateFrameIsTakenAgainAndNoOther) {
  SmallVisit();
  Learn();
  const Taken taken = Take({{FaultKind::kFrameSlow, 58, 1, 40.0}});  // of no Gray code: these are taken in pairs
  EXPECT_EQ(taken.report.status, SessionStatus::kComplete);
  EXPECT_EQ(taken.report.retried, 1) << taken.report.FaultSummary();
  EXPECT_EQ(taken.report.Count(ShotFault::kLostFrame), 1);
  EXPECT_EQ(taken.report.Count(ShotFault::kOutOfOrder), 0) << "the given up frame harms nothing when it comes";
  ExpectSaid(taken.report, "until then the configured deadlines hold");
}

TEST_F(LearntDeadlinesTest, AStreamIsLearntToo) {
  SmallVisit();
  plan_.sync_mode = SyncMode::kFreeRunning;
  Learn();
  EXPECT_NEAR(delays_.frame_period_ms, timing_.frame_period_ms, 0.1);
  const Taken healthy = Take();
  EXPECT_EQ(healthy.report.status, SessionStatus::kComplete);
  EXPECT_EQ(healthy.report.retried, 0) << healthy.report.FaultSummary();
  EXPECT_TRUE(healthy.report.slow.empty()) << SlowAnswersAsText(healthy.report.slow.front());
  timing_.frame_period_ms = 60.0;
  timing_.sync_delay_ms += 8.0;
  const Taken slower = Take();
  EXPECT_EQ(slower.report.status, SessionStatus::kComplete) << slower.report.FaultSummary();
  EXPECT_EQ(slower.report.retried, 0) << slower.report.FaultSummary();
  ExpectSaid(slower.report, "SYNC of projector 0");
}

}  // namespace
}  // namespace stratalux::rig
