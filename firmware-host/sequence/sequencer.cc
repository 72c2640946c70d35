// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/sequencer.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "firmware-host/sequence/capture_run.h"
#include "firmware-host/sequence/dark_on_exception.h"

namespace stratalux::rig {

Status CheckFits(const CapturePlan& plan, const RigDevices& devices) {
  const PlanOptions& o = plan.options;
  if (plan.steps.empty()) return Status::Usage("plan: it has no steps");
  if (o.sync_mode == SyncMode::kFreeRunning && devices.camera.follows_trigger())
    return Status::Usage("plan: sync mode 'free_running', but this camera exposes on our trigger; use 'triggered'");
  if (o.sync_mode == SyncMode::kTriggered && !devices.camera.follows_trigger())
    return Status::Usage("plan: sync mode 'triggered', but this camera runs freely; use 'free_running'");
  if (o.projectors != static_cast<int>(devices.projectors.size()))
    return Status::Usage("plan: " + std::to_string(o.projectors) + " projectors, the rig has " +
                         std::to_string(devices.projectors.size()));
  for (size_t p = 0; p < devices.projectors.size(); ++p)
    if (devices.projectors[p]->width() != o.projector_width || devices.projectors[p]->height() != o.projector_height)
      return Status::Usage("plan: patterns of " + std::to_string(o.projector_width) + "x" +
                           std::to_string(o.projector_height) + " px, projector " + std::to_string(p) + " has " +
                           std::to_string(devices.projectors[p]->width()) + "x" +
                           std::to_string(devices.projectors[p]->height()));
  return Status::Ok();
}

// Of a response that bends by b x (1 - x) a sinusoid's mean is off by b / 8, a pair's sum by b / 2 at most.
Status CheckResponse(const CapturePlan& plan, const WitnessOptions& witness) {
  if (IsOfStripes(plan.options.ShownCode())) return Status::Ok();
  const size_t known = std::min(witness.sinusoid_mean.size(), static_cast<size_t>(plan.options.projectors));
  for (size_t p = 0; p < known; ++p)
    if (4.0 * std::abs(witness.sinusoid_mean[p] - 0.5) > witness.sum_tolerance)
      return Status::Usage("plan: code '" + std::string(ToString(plan.options.code)) +
                           "' needs projectors of linear "
                           "response, but projector " +
                           std::to_string(p) + " gives a sinusoid " + std::to_string(witness.sinusoid_mean[p]) +
                           " of white's light, not 0.5; use another code");
  return Status::Ok();
}

Status SequencerOptions::Validate() const {
  if (max_retries < 0 || max_retries > 100)
    return Status::Usage("max_retries = " + std::to_string(max_retries) + ", allowed: 0 .. 100");
  if (max_useless_shots < 1)
    return Status::Usage("max_useless_shots = " + std::to_string(max_useless_shots) + ", allowed: 1 or more");
  if (max_reference_asks < 0)
    return Status::Usage("max_reference_asks = " + std::to_string(max_reference_asks) + ", allowed: 0 or more");
  if (shooter.settle.count() < 0 || shooter.sync_deadline.count() <= 0 || shooter.frame_deadline.count() <= 0 ||
      shooter.frame_slack.count() < 0 || max_on_time.count() < 0 || max_useless_time.count() < 0 ||
      step_slack.count() < 0)
    return Status::Usage("sequencer: settling, deadlines, slack, on-time and useless time must not be negative");
  return Status::Ok();
}

std::chrono::nanoseconds SequencerOptions::LongestStep(double exposure_ms) const {
  // A stream's next whole exposure may begin an exposure later; a triggered frame is awaited while the next one begins.
  const CameraTiming& camera = shooter.camera;
  return shooter.sync_deadline + shooter.settle + FromMilliseconds(2.0 * exposure_ms) + camera.exposure_margin +
         camera.min_frame_period + shooter.frame_deadline + step_slack;
}

Sequencer::Sequencer(RigDevices devices, SequencerOptions options, Logger& logger, CaptureObserver* observer)
    : devices_(std::move(devices)), options_(std::move(options)), logger_(logger), observer_(observer) {}

Result<CaptureReport> Sequencer::Run(const CapturePlan& plan, FrameSink& sink) {
  SLX_RETURN_IF_ERROR(options_.Validate());
  SLX_RETURN_IF_ERROR(CheckFits(plan, devices_));
  SLX_RETURN_IF_ERROR(CheckResponse(plan, options_.witness));
  CaptureObserver silent;
  CaptureRun run(plan, devices_, options_, logger_, observer_ != nullptr ? *observer_ : silent, sink);
  const DarkOnException guard(devices_);
  Status ended = devices_.camera.Start().WithContext("camera");
  if (ended.ok()) ended = run.Run();
  // Lights first: nothing that follows may keep a lamp on a face.
  const Status off = devices_.light.AllOff();
  const Status stopped = devices_.camera.Stop().WithContext("camera");
  // What the sink refuses now is lost to a capture that failed anyway.
  static_cast<void>(run.EmitHeld().ok());
  if (ended.ok()) ended = off.ok() ? stopped : off;
  CaptureReport report = run.Conclude(ended);
  if (!off.ok() && off.message() != ended.message())
    report.findings.push_back({FindingKind::kDevice, -1, -1, 0.0, 0.0, off.message()});
  return report;
}

}  // namespace stratalux::rig
