// SPDX-License-Identifier: Apache-2.0
// From one section of a filled memory to the next, with nothing in between that would bring it into step.
#include <map>
#include <memory>
#include <optional>
#include <vector>

#include <gtest/gtest.h>

#include "firmware-host/projector/memory_layout.h"
#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/simulated_rig.h"

namespace stratalux::rig {
namespace {

// The last frame of each step that did not fail its check, by what it really shows.
struct ShownSteps : FrameSink {
  explicit ShownSteps(const SimulatedRig& simulation) : rig(simulation) {}
  Status Put(FrameRecord record, Image<uint16_t>) override {
    if (record.level_check != LevelCheck::kFailed) of_step[record.step] = rig.ShownOf(record.driver_sequence);
    return Status::Ok();
  }
  const SimulatedRig& rig;
  std::map<int, ShownFrame> of_step;
};

class SectionChange : public ::testing::Test {
 protected:
  SectionChange() {
    options_.projector_width = 64;
    options_.projector_height = 48;
    options_.comb_period = 16;
    options_.spot_pitch = 16;
    options_.spot_radius = 2;
    options_.motion_whites = 3;
  }
  [[nodiscard]] CapturePlan Plan(SessionKind kind) const {
    PlanOptions options = options_;
    options.kind = kind;
    return BuildPlan(options).value();
  }
  void Open(const std::vector<Fault>& faults) {
    SimulatedRigOptions rig;
    rig.scene = "plane";
    rig.scattering = false;
    rig.camera_width = 116;
    rig.camera_height = 88;
    rig.projector_width = options_.projector_width;
    rig.projector_height = options_.projector_height;
    rig.devices.timing.memory_reset_ms = 1000.0;  // never the shorter way
    rig.devices.timing.memory_step_ms = 1.0;
    rig.faults.script = faults;
    rig.memories = LayOutMemories(options_)->Patterns();
    auto made = SimulatedRig::Create(rig, logger_);
    ASSERT_TRUE(made.ok()) << made.status().message();
    rig_ = std::move(*made);
    auto light = GuardLight(*rig_, stop_);
    ASSERT_TRUE(light.ok()) << light.status().message();
    light_ = std::move(*light);
  }
  // Complete, each frame showing what its step asks for.
  CaptureReport Capture(SessionKind kind) {
    SequencerOptions sequencer;
    sequencer.shooter.wait = [&](std::chrono::nanoseconds time) { rig_->Sleep(time); };
    const CapturePlan plan = Plan(kind);
    ShownSteps frames(*rig_);
    const auto report =
        Sequencer({*light_, rig_->lines(), rig_->camera(), rig_->projectors()}, sequencer, logger_).Run(plan, frames);
    EXPECT_TRUE(report.ok()) << report.status().message();
    EXPECT_EQ(report->status, SessionStatus::kComplete) << report->FaultSummary();
    EXPECT_EQ(frames.of_step.size(), plan.steps.size());
    for (const auto& [index, shown] : frames.of_step) {
      const PlanStep& step = plan.steps[static_cast<size_t>(index)];
      for (int p = 0; p < static_cast<int>(shown.pictures.size()); ++p) {
        const bool lit = step.projector < 0 || step.projector == p;
        EXPECT_EQ(shown.pictures[static_cast<size_t>(p)], lit ? std::optional(step.pattern) : std::nullopt)
            << ToString(kind) << ", step " << index << ", projector " << p;
      }
    }
    return *report;
  }

  PlanOptions options_;
  Logger logger_{LogLevel::kError};
  StopToken stop_;
  std::unique_ptr<SimulatedRig> rig_;
  std::unique_ptr<LightGuard> light_;
};

TEST_F(SectionChange, EveryKindFollowsTheOthersWithoutAFault) {
  Open({});
  for (const SessionKind kind :
       {SessionKind::kVisitor, SessionKind::kCalibration, SessionKind::kResponse, SessionKind::kVisitor})
    EXPECT_EQ(Capture(kind).retried, 0) << ToString(kind);
  EXPECT_EQ(rig_->fillings(), 0);
}

// A memory that went out of step with the last frame of one section, where black followed black and nobody could see
// it, is walked on by its count, one off: the pre-roll of the next section tells.
TEST_F(SectionChange, AMemoryOutOfStepIsFoundInTheNextSection) {
  const size_t pulses = Plan(SessionKind::kVisitor).steps.size();
  Open({*ParseFault("projector_lag@" + std::to_string(pulses - 1))});
  Capture(SessionKind::kVisitor);
  ASSERT_EQ(rig_->injected().size(), 1U);
  const CaptureReport next = Capture(SessionKind::kCalibration);
  EXPECT_GE(next.retried, 1) << "nobody noticed";
  EXPECT_EQ(Capture(SessionKind::kVisitor).retried, 0);
}

}  // namespace
}  // namespace stratalux::rig
