// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/motion/motion_trial.h"

#include <algorithm>

namespace stratalux::rig {
namespace {

struct NoSink : FrameSink {
  Status Put(FrameRecord, Image<uint16_t>) override { return Status::Ok(); }
};

Result<CapturePlan> PlanOfOne(int projector) {
  PlanOptions options;
  options.preroll_markers = 0;  // they would need the light of all four
  options.spot_radius = 0;
  SLX_ASSIGN_OR_RETURN(CapturePlan plan, BuildPlan(options));
  std::erase_if(plan.steps, [projector](const PlanStep& step) { return step.projector != projector; });
  for (size_t i = 0; i < plan.steps.size(); ++i) plan.steps[i].index = static_cast<int>(i);
  return plan;
}

}  // namespace

Result<std::unique_ptr<MotionRig>> MotionRig::Create(const MotionRigOptions& options) {
  std::unique_ptr<MotionRig> made(new MotionRig);
  SLX_ASSIGN_OR_RETURN(made->plan_, PlanOfOne(options.projector));
  SimulatedRigOptions rig;
  rig.seed = options.seed;
  rig.scene = options.scene;
  rig.scattering = options.scattering;
  rig.camera_width = options.camera_width;
  rig.camera_height = options.camera_height;
  rig.projector_width = made->plan_.options.projector_width;
  rig.projector_height = made->plan_.options.projector_height;
  rig.faults = options.faults;
  SLX_ASSIGN_OR_RETURN(made->rig_, SimulatedRig::Create(rig, made->logger_));
  SLX_ASSIGN_OR_RETURN(made->light_, GuardLight(*made->rig_, made->stop_));
  return made;
}

Result<CaptureReport> MotionRig::Capture(FrameSink* sink) {
  NoSink nowhere;
  SequencerOptions options;
  options.shooter.wait = [this](std::chrono::nanoseconds time) { rig_->Sleep(time); };
  Sequencer sequencer({*light_, rig_->lines(), rig_->camera(), rig_->projectors()}, options, logger_);
  return sequencer.Run(plan_, sink != nullptr ? *sink : nowhere);
}

int MotionRig::first_comb() const {
  return static_cast<int>(std::find_if(plan_.steps.begin(), plan_.steps.end(),
                                       [](const PlanStep& step) { return step.phase == CapturePhase::kSweep; }) -
                          plan_.steps.begin());
}

int MotionRig::last_comb() const {
  int last = first_comb();
  for (const PlanStep& step : plan_.steps)
    if (step.phase == CapturePhase::kSweep) last = step.index;
  return last;
}

}  // namespace stratalux::rig
