// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/shooter.h"

#include <algorithm>
#include <thread>
#include <utility>

namespace stratalux::rig {
namespace {

double MeanLevel(const Image<uint16_t>& pixels) {
  uint64_t sum = 0;
  for (uint16_t value : pixels.pixels()) sum += value;
  return pixels.empty() ? 0.0 : static_cast<double>(sum) / static_cast<double>(pixels.size());
}

}  // namespace

Shooter::Shooter(RigDevices devices, ShooterOptions options)
    : devices_(std::move(devices)), options_(std::move(options)), pairing_(options_.frame_slack) {
  if (!options_.wait) options_.wait = [](std::chrono::nanoseconds time) { std::this_thread::sleep_for(time); };
}

Result<Shot> Shooter::Take(const PlanStep& step, int retry) {
  if (step.exposure_ms != exposure_ms_) {
    SLX_RETURN_IF_ERROR(devices_.camera.SetExposure(step.exposure_ms, options_.gain));
    exposure_ms_ = step.exposure_ms;
  }
  SLX_ASSIGN_OR_RETURN(const TriggerReceipt step_pulse, devices_.lines.TriggerProjector(step.projector));
  SLX_ASSIGN_OR_RETURN(const std::optional<MonotonicNs> sync, AwaitSync(step.projector, step_pulse));
  Shot shot;
  if (!sync) {
    shot.fault = ShotFault::kMissingSync;
    return shot;
  }
  options_.wait(options_.settle);
  SLX_ASSIGN_OR_RETURN(const TriggerReceipt trigger, devices_.lines.TriggerCamera());
  last_trigger_ = trigger.time;
  // The bank's number may count the projectors' pulses, too; frames advance with the camera's own.
  const TriggerReceipt camera_pulse{camera_triggers_++, trigger.time};
  SLX_ASSIGN_OR_RETURN(shot, AwaitFrame(step, camera_pulse));
  FrameRecord& r = shot.record;
  r.step = step.index;
  r.projector = step.projector;
  r.phase = step.phase;
  r.pattern = step.pattern;
  r.bracket = step.bracket;
  r.retry = retry;
  r.trigger_number = trigger.number;
  r.trigger_time = trigger.time;
  r.sync_time = *sync;
  return shot;
}

Result<std::optional<MonotonicNs>> Shooter::AwaitSync(int projector, const TriggerReceipt& trigger) {
  std::vector<bool> seen(devices_.projectors.size(), projector >= 0);
  if (projector >= 0) seen[projector] = false;
  const auto deadline = std::chrono::steady_clock::now() + options_.sync_deadline;
  MonotonicNs latest{};
  while (std::find(seen.begin(), seen.end(), false) != seen.end()) {
    const auto left = std::max<std::chrono::nanoseconds>(deadline - std::chrono::steady_clock::now(), {});
    SLX_ASSIGN_OR_RETURN(const std::optional<SyncEdge> edge, devices_.lines.WaitSync(left));
    if (!edge) return std::optional<MonotonicNs>();
    const bool known = edge->projector >= 0 && edge->projector < static_cast<int>(seen.size());
    if (!known || edge->time < trigger.time) continue;  // an edge of the past is not this pulse's answer
    seen[edge->projector] = true;
    latest = std::max(latest, edge->time);
  }
  return std::optional<MonotonicNs>(latest);
}

Result<Shot> Shooter::AwaitFrame(const PlanStep& step, const TriggerReceipt& trigger) {
  const auto exposure = std::chrono::nanoseconds(static_cast<int64_t>(step.exposure_ms * 1e6));
  const auto deadline = std::chrono::steady_clock::now() + exposure + options_.frame_deadline;
  Shot shot;
  while (true) {
    const auto left = std::max<std::chrono::nanoseconds>(deadline - std::chrono::steady_clock::now(), {});
    SLX_ASSIGN_OR_RETURN(std::optional<CapturedFrame> frame, devices_.camera.Wait(left));
    if (!frame) {
      pairing_.TriggerLost();
      // A frame of the past is no answer: what was seen first stays the named cause.
      if (shot.fault == ShotFault::kNone) shot.fault = ShotFault::kLostFrame;
      return shot;
    }
    SLX_RETURN_IF_ERROR(CheckFrame(*frame));
    const ShotFault fault = pairing_.Match(trigger, step.exposure_ms, *frame);
    if (fault == ShotFault::kOutOfOrder || fault == ShotFault::kDoubledFrame) {
      shot.fault = fault;
      continue;
    }
    if (shot.fault == ShotFault::kNone) shot.fault = fault;
    FrameRecord& r = shot.record;
    r.driver_sequence = frame->sequence;
    r.frame_time = frame->time;
    r.frame_clock = frame->clock;
    r.exposure_ms = frame->exposure_ms;
    r.gain = frame->gain;
    r.format = frame->format;
    r.cfa = frame->cfa;
    r.width = frame->pixels.width();
    r.height = frame->pixels.height();
    r.channels = frame->pixels.channels();
    r.mean_dn = MeanLevel(frame->pixels);
    shot.pixels = std::move(frame->pixels);
    return shot;
  }
}

Status Shooter::CheckFrame(const CapturedFrame& frame) {
  if (frame.clock == ClockSource::kUnknown)
    return Status::Failed("camera: frame " + std::to_string(frame.sequence) +
                          " has a time of an unknown clock, so no frame can be paired with its trigger; use a driver "
                          "that stamps frames with CLOCK_MONOTONIC");
  if (frame.corrupt) return Status::Ok();  // its size means nothing; pairing names it
  if (!first_) {
    first_width_ = frame.pixels.width();
    first_height_ = frame.pixels.height();
    first_.emplace();
    first_->format = frame.format;
    first_->clock = frame.clock;
    first_->cfa = frame.cfa;
  }
  if (frame.pixels.width() != first_width_ || frame.pixels.height() != first_height_ ||
      frame.format != first_->format || frame.clock != first_->clock || frame.cfa != first_->cfa)
    return Status::Failed("camera: frame " + std::to_string(frame.sequence) + " is " +
                          std::to_string(frame.pixels.width()) + "x" + std::to_string(frame.pixels.height()) +
                          ", the first one was " + std::to_string(first_width_) + "x" + std::to_string(first_height_) +
                          " (or its format or clock changed)");
  return Status::Ok();
}

Result<ShotFault> Shooter::Drain() {
  ShotFault worst = ShotFault::kNone;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const std::optional<SyncEdge> edge, devices_.lines.WaitSync({}));
    if (!edge) break;
    worst = ShotFault::kExtraSync;
  }
  while (true) {
    SLX_ASSIGN_OR_RETURN(const std::optional<CapturedFrame> frame, devices_.camera.Wait({}));
    if (!frame) break;
    const ShotFault fault = pairing_.Unexpected(*frame);
    if (worst == ShotFault::kNone) worst = fault;
  }
  return worst;
}

}  // namespace stratalux::rig
