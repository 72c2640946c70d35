// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/motion/motion_trial.h"

#include <algorithm>
#include <map>
#include <utility>

namespace stratalux::rig {
namespace {

struct LastFrames : FrameSink {
  Status Put(FrameRecord record, Image<uint16_t> pixels) override {
    of_step[record.step] = std::move(pixels);
    return Status::Ok();
  }
  std::map<int, Image<uint16_t>> of_step;
};

// What the comb cycle was judged by before each probe was: the sum of its frames over white, all lit pixels in one.
double MeanSum(const CapturePlan& plan, const std::map<int, Image<uint16_t>>& frames, const WitnessOptions& options) {
  const Image<uint16_t>& white = frames.at(0);
  const Image<uint16_t>& black = frames.at(1);
  double combs = 0.0, whites = 0.0;
  for (size_t i = 0; i < white.size(); ++i) {
    const double contrast = double(white.data()[i]) - black.data()[i];
    if (contrast < options.min_contrast_dn || white.data()[i] >= options.saturation_dn) continue;
    whites += contrast;
    for (const PlanStep& step : plan.steps)
      if (step.phase == CapturePhase::kSweep) combs += double(frames.at(step.index).data()[i]) - black.data()[i];
  }
  return combs * plan.options.comb_step / plan.options.comb_width / whites;
}

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
  made->witness_ = options.witness;
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

bool MotionCapture::Says(FindingKind kind) const {
  return std::any_of(findings.begin(), findings.end(), [kind](const Finding& f) { return f.kind == kind; });
}

Result<MotionCapture> MotionRig::Capture() {
  LastFrames frames;
  SequencerOptions options;
  options.witness = witness_;
  options.witness.gain_e_per_dn = rig_->calibration().camera.gain_e_per_dn;
  options.witness.read_noise_dn = rig_->calibration().camera.read_noise_dn;
  options.shooter.wait = [this](std::chrono::nanoseconds time) { rig_->Sleep(time); };
  Sequencer sequencer({*light_, rig_->lines(), rig_->camera(), rig_->projectors()}, options, logger_);
  SLX_ASSIGN_OR_RETURN(const CaptureReport report, sequencer.Run(plan_, frames));
  if (frames.of_step.size() != plan_.steps.size()) return Status::Failed("a frame is missing");
  MotionCapture capture{.status = report.status, .retried = report.retried, .findings = report.findings};
  capture.unproven = report.planned - report.captured;
  capture.jumps = report.Count(ShotFault::kSubjectMoved);
  capture.mean_sum = MeanSum(plan_, frames.of_step, options.witness);
  return capture;
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
