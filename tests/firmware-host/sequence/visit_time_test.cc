// SPDX-License-Identifier: Apache-2.0
// What `plan show --simulate` says of the default visit against the simulated rig's clock. The pictures are small, the
// skin opaque: the clock does not depend on either.
#include "firmware-host/sequence/visit_time.h"

#include <cmath>
#include <iostream>

#include <gtest/gtest.h>

#include "firmware-host/apps/plan_command.h"
#include "firmware-host/projector/memory_layout.h"
#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "firmware-host/simulated/simulation_file.h"

namespace stratalux::rig {
namespace {

class NoSink : public FrameSink {
 public:
  Status Put(FrameRecord, Image<uint16_t>) override { return Status::Ok(); }
};

double InSeconds(std::chrono::nanoseconds time) { return 1e-9 * static_cast<double>(time.count()); }

class VisitTimeTest : public ::testing::Test {
 protected:
  VisitTimeTest() {
    const Result<Simulation> overlapped = LoadSimulation(STRATALUX_SOURCE_DIR "/docs/examples/scenes/overlapped.toml");
    EXPECT_TRUE(overlapped.ok()) << overlapped.status().message();
    timing_ = overlapped->devices.timing;
  }
  // Seconds of the rig's clock from the memories' rest to the last frame.
  double Take() {
    SimulatedRigOptions options;
    options.camera_width = 232;
    options.camera_height = 174;
    options.scattering = false;
    options.free_running = config_.plan.sync_mode == SyncMode::kFreeRunning;
    options.devices.timing = timing_;
    options.faults.script = faults_;
    const CapturePlan plan = *BuildPlan(config_.plan);
    options.memories = LayOutMemories(config_.plan, config_.memory)->Patterns();
    const auto rig = SimulatedRig::Create(options, logger_);
    EXPECT_TRUE(rig.ok()) << rig.status().message();
    SequencerOptions sequencer;
    sequencer.shooter.settle = FromMilliseconds(config_.settle_ms);
    sequencer.shooter.camera = CameraTimingOf(timing_, CameraTimingOf(config_.camera));
    sequencer.shooter.wait = [&](std::chrono::nanoseconds time) { (*rig)->Sleep(time); };
    StopToken stop;
    const auto light = GuardLight(**rig, stop);
    EXPECT_TRUE(light.ok()) << light.status().message();
    NoSink sink;
    for (Projector* projector : (*rig)->projectors()) EXPECT_TRUE(projector->Rest().ok());
    const MonotonicNs start = (*rig)->clock().Now();
    const Result<CaptureReport> report =
        Sequencer({**light, (*rig)->lines(), (*rig)->camera(), (*rig)->projectors()}, sequencer, logger_)
            .Run(plan, sink);
    EXPECT_TRUE(report.ok()) << report.status().message();
    EXPECT_EQ(report->status, SessionStatus::kComplete) << report->FaultSummary();
    EXPECT_EQ((*rig)->injected().size(), faults_.size());
    return InSeconds((*rig)->clock().Now() - start);
  }
  double Said() const { return InSeconds(VisitTime(*BuildPlan(config_.plan), TimingOf(config_, timing_))); }
  void ExpectTold(const char* what) {
    const double said = Said(), took = Take();
    std::cout << what << ": said " << said << " s, took " << took << " s\n";
    EXPECT_NEAR(said / took, 1.0, 0.05) << what;
  }
  // From RESET to a step of the plan, that and all before it shown.
  double SteppingTo(const CapturePlan& plan, int step) const {
    int before = 0;
    for (int i = 0; i < step; ++i)
      before += plan.steps[i].projector < 0 || plan.steps[i].projector == plan.steps[step].projector;
    return 1e-3 * (timing_.memory_reset_ms + before * timing_.memory_step_ms);
  }

  RigConfig config_;
  RigTiming timing_;  // of the overlapped camera, 60 frames/s
  std::vector<Fault> faults_;
  Logger logger_{LogLevel::kError};
};

TEST_F(VisitTimeTest, TheDefaultVisitTakesTenSecondsAtMostAndIsToldWithinFivePercent) {
  const double said = Said(), took = Take();
  std::cout << "overlapped: said " << said << " s, took " << took << " s\n";
  EXPECT_EQ(BuildPlan(config_.plan)->steps.size(), 500U);
  EXPECT_LE(took, 10.0);
  EXPECT_NEAR(said / took, 1.0, 0.05);
}

TEST_F(VisitTimeTest, ASlowProjectorIsReckonedWith) {
  timing_.sync_delay_ms = 8.0;
  ExpectTold("overlapped, 8 ms to SYNC");
}

TEST_F(VisitTimeTest, ALongReadOutSetsThePace) {
  timing_.readout_ms = 30.0;
  ExpectTold("overlapped, 30 ms of read-out");
}

TEST_F(VisitTimeTest, ASerialCameraIsAwaited) {
  timing_.overlapped_readout = false;
  ExpectTold("serial");
  timing_.sync_delay_ms = 8.0;
  timing_.readout_ms = 15.0;
  ExpectTold("serial, 15 ms of read-out, 8 ms to SYNC");
}

TEST_F(VisitTimeTest, AStreamGoesInWholePeriods) {
  config_.plan.sync_mode = SyncMode::kFreeRunning;
  ExpectTold("free running");
}

// The visit's own section begins where the memories rest; the others lie behind it.
TEST_F(VisitTimeTest, TheWayToASectionIsReckonedWith) {
  timing_.memory_reset_ms = 50.0;
  timing_.memory_step_ms = 4.0;
  const double visit = Said();
  ExpectTold("visit, memories of 4 ms a step");
  timing_.memory_step_ms = 40.0;
  EXPECT_EQ(Said(), visit) << "no way at all";
  timing_.memory_step_ms = 4.0;
  config_.plan.kind = SessionKind::kCalibration;
  const MemoryLayout layout = *LayOutMemories(config_.plan);
  double way = 0.0;
  for (const ProjectorMemory& memory : layout.projectors)
    for (const SectionPlace& place : memory.sections)
      if (place.section == MemorySection::kCalibration) way += 1e-3 * place.first * timing_.memory_step_ms;
  EXPECT_GT(way, 2.0) << "131 steps of each of four memories";
  ExpectTold("calibration, memories of 4 ms a step");
  const double with_way = Said();
  timing_.memory_step_ms = 0.0;
  EXPECT_NEAR(with_way - Said(), way, 1e-6);
}

TEST_F(VisitTimeTest, TwoLostFramesCostLittleBeyondTheMemorysSteps) {
  timing_.memory_reset_ms = 50.0;
  timing_.memory_step_ms = 4.0;
  const double healthy = Take();
  const CapturePlan plan = *BuildPlan(config_.plan);
  // A Gray code's and a comb's. The frame that follows the first is exposed for nothing, so that later exposures have
  // two steps' numbers less.
  faults_ = {*ParseFault("frame_lost@20"), *ParseFault("frame_lost@302")};
  const double stepping = SteppingTo(plan, 20) + SteppingTo(plan, 300);
  const double took = Take();
  std::cout << "two lost frames: " << took - healthy << " s more, " << stepping << " s of it the memory's steps\n";
  EXPECT_GT(took - healthy, stepping);
  EXPECT_LE(took - healthy - stepping, 0.3);
}

}  // namespace
}  // namespace stratalux::rig
