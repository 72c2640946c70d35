// SPDX-License-Identifier: Apache-2.0
// The sequencer on the simulated rig: scattering skin, noise and blur must raise no false alarm.
#include <algorithm>
#include <map>
#include <string>
#include <vector>

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

// The default plan on a rig.
Result<CaptureReport> Captured(const SimulatedRigOptions& rig_options, CountingSink& sink) {
  Logger logger(LogLevel::kError);
  SLX_ASSIGN_OR_RETURN(const auto rig, SimulatedRig::Create(rig_options, logger));
  SequencerOptions options;
  options.shooter.wait = [&](std::chrono::nanoseconds time) { rig->Sleep(time); };
  StopToken stop;
  SLX_ASSIGN_OR_RETURN(const auto light, GuardLight(*rig, stop));
  Sequencer sequencer({*light, rig->lines(), rig->camera(), rig->projectors()}, options, logger);
  return sequencer.Run(*BuildPlan({}), sink);
}

std::vector<Finding> FindingsOfASphere(const Fault& fault) {
  SimulatedRigOptions rig;
  rig.camera_width = 174;
  rig.camera_height = 130;
  rig.scene = "sphere";
  rig.scattering = false;
  rig.faults.script = {fault};
  CountingSink sink;
  const auto report = Captured(rig, sink);
  EXPECT_TRUE(report.ok()) << report.status().message();
  return report.ok() ? report->findings : std::vector<Finding>();
}

// Between two projectors no white and no comb tells: only that the projectors' whites no longer add up to the
// pre-roll's.
TEST(SimulatedCapture, WhoMovesBetweenTwoProjectorsHasMovedAndALampIsALamp) {
  const CapturePlan plan = *BuildPlan({});
  const auto says = [](const std::vector<Finding>& findings, FindingKind kind) {
    return std::ranges::any_of(findings, [kind](const Finding& f) { return f.kind == kind; });
  };
  for (const int projector : {2, 3}) {
    const auto first =
        std::ranges::find_if(plan.steps, [projector](const PlanStep& step) { return step.projector == projector; });
    const int at = static_cast<int>(first - plan.steps.begin());
    const auto moved = FindingsOfASphere({.kind = FaultKind::kSubjectMoved, .at = at, .value = 3.0});
    EXPECT_TRUE(says(moved, FindingKind::kMoved)) << projector << ::testing::PrintToString(ToText(moved));
    const auto lamp = FindingsOfASphere({.kind = FaultKind::kLampDrift, .at = at, .value = 0.85});
    EXPECT_TRUE(says(lamp, FindingKind::kLamp)) << projector << ::testing::PrintToString(ToText(lamp));
    EXPECT_FALSE(says(lamp, FindingKind::kMoved)) << projector << ::testing::PrintToString(ToText(lamp));
  }
}

TEST(SimulatedCapture, AVisitorIsCompleteAndEveryCodedFrameIsWitnessed) {
  SimulatedRigOptions rig;
  rig.camera_width = 232;
  rig.camera_height = 174;
  CountingSink sink;
  const Result<CaptureReport> report = Captured(rig, sink);
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
