// SPDX-License-Identifier: Apache-2.0
// The sequencer on the simulated rig: scattering skin, noise and blur must raise no false alarm.
#include <map>

#include <gtest/gtest.h>

#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/simulated_rig.h"

namespace stratalux::rig {
namespace {

class CountingSink : public FrameSink {
 public:
  Status Put(FrameRecord record, Image<uint16_t>) override {
    ++checks[{record.phase, record.level_check}];
    return Status::Ok();
  }
  std::map<std::pair<CapturePhase, LevelCheck>, int> checks;
};

TEST(SimulatedCapture, AVisitorIsCompleteAndEveryCodedFrameIsWitnessed) {
  Logger logger(LogLevel::kWarning);
  SimulatedRigOptions rig_options;
  rig_options.camera_width = 232;
  rig_options.camera_height = 174;
  Result<std::unique_ptr<SimulatedRig>> rig = SimulatedRig::Create(rig_options, logger);
  ASSERT_TRUE(rig.ok()) << rig.status().message();
  const CapturePlan plan = *BuildPlan({});
  SequencerOptions options;
  options.shooter.wait = [&](std::chrono::nanoseconds time) { (*rig)->Sleep(time); };
  StopToken stop;
  const auto light = GuardLight(**rig, stop);
  ASSERT_TRUE(light.ok()) << light.status().message();
  Sequencer sequencer({**light, (*rig)->lines(), (*rig)->camera(), (*rig)->projectors()}, options, logger);
  CountingSink sink;
  const Result<CaptureReport> report = sequencer.Run(plan, sink);
  ASSERT_TRUE(report.ok()) << report.status().message();
  std::string reasons;
  for (const std::string& reason : report->Reasons()) reasons += reason + "\n";
  EXPECT_EQ(report->status, SessionStatus::kComplete) << reasons;
  EXPECT_EQ(report->retried, 0) << report->FaultSummary();
  for (CapturePhase phase : {CapturePhase::kPreroll, CapturePhase::kReference, CapturePhase::kCorrespondence,
                             CapturePhase::kSeparation, CapturePhase::kSweep, CapturePhase::kMotion})
    EXPECT_EQ(sink.checks.count({phase, LevelCheck::kNotChecked}), 0U) << ToString(phase);
}

}  // namespace
}  // namespace stratalux::rig
