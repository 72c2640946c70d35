// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/shooter.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <thread>
#include <utility>

#include "firmware-host/sequence/probe_lattice.h"

namespace stratalux::rig {
namespace {

using std::chrono::nanoseconds;
constexpr MonotonicNs kNever{std::numeric_limits<int64_t>::max()};
// For a frame that may be here already when its deadline has passed while nobody looked.
constexpr nanoseconds kLeastWait = std::chrono::milliseconds(20);
constexpr size_t kGivenUp = 4;

// Waits with `wait` in slices until it gives something, `safe` objects or `left` has passed; takes from `left` what the
// waiting took. A device's clock may be its own: a wait counts for no longer than it was told to be, and as long as
// that when it gave nothing.
template <typename T, typename Wait>
Result<std::optional<T>> WaitSafely(nanoseconds& left, const std::function<Status()>& safe, const Wait& wait) {
  while (true) {
    SLX_RETURN_IF_ERROR(safe());
    const nanoseconds slice = std::min(left, kLongestUnasked);
    const auto start = std::chrono::steady_clock::now();
    SLX_ASSIGN_OR_RETURN(std::optional<T> got, wait(slice));
    if (got) {
      const nanoseconds took = std::min(slice, nanoseconds(std::chrono::steady_clock::now() - start));
      left = std::max(nanoseconds(0), left - took);
      return got;
    }
    left -= slice;
    if (left.count() <= 0) return got;
  }
}

bool IsNear(double reported, double set, double tolerance) { return std::abs(reported - set) <= tolerance * set; }

}  // namespace

Shooter::Shooter(RigDevices devices, ShooterOptions options, SyncMode mode, std::function<Status()> safe)
    : devices_(std::move(devices)),
      options_(std::move(options)),
      mode_(mode),
      safe_(std::move(safe)),
      pairing_(options_.frame_slack),
      watch_(options_.sync_deadline, options_.frame_deadline, static_cast<int>(devices_.projectors.size()),
             options_.learnt) {
  if (!options_.wait) options_.wait = [](nanoseconds time) { std::this_thread::sleep_for(time); };
}

Result<Shot> Shooter::Take(const PlanStep& step, int retry) {
  SLX_ASSIGN_OR_RETURN(std::optional<StepExposure> exposure, Show(step, retry));
  if (!exposure) {
    Shot shot;
    shot.fault = ShotFault::kMissingSync;
    return shot;
  }
  SLX_RETURN_IF_ERROR(Expose(*exposure));
  return Collect(*exposure);
}

Result<Patience> Shooter::Prepare(const PlanStep& step) {
  SLX_RETURN_IF_ERROR(safe_());
  Patience patience = Patience::kLearnt;
  if (step.exposure_ms != exposure_ms_) {
    SLX_RETURN_IF_ERROR(devices_.camera.SetExposure(step.exposure_ms, options_.gain));
    exposure_ms_ = step.exposure_ms;
    patience = Patience::kConfigured;
  }
  if (mode_ == SyncMode::kFreeRunning) SLX_RETURN_IF_ERROR(PassOverStream());
  return patience;
}

Result<Shot> Shooter::Snap(const PlanStep& like) {
  StepExposure exposure;
  SLX_ASSIGN_OR_RETURN(exposure.patience, Prepare(like));
  exposure.step = &like;
  exposure.pulse = {camera_triggers_, devices_.light.Now()};
  exposure.sync = exposure.pulse.time + -options_.settle;  // nothing has to settle
  SLX_RETURN_IF_ERROR(Expose(exposure));
  return Collect(exposure);
}

Result<std::optional<StepExposure>> Shooter::Show(const PlanStep& step, int retry) {
  StepExposure exposure;
  SLX_ASSIGN_OR_RETURN(exposure.patience, Prepare(step));
  exposure.step = &step;
  exposure.retry = retry;
  const Patience patience = retry > 0 ? Patience::kConfigured : Patience::kLearnt;
  if (retry > 0) exposure.patience = patience;
  SLX_ASSIGN_OR_RETURN(exposure.pulse, devices_.lines.TriggerProjector(step.projector));
  last_pulse_ = exposure.pulse.time;
  SLX_ASSIGN_OR_RETURN(const std::optional<MonotonicNs> sync, AwaitSync(step.projector, exposure.pulse, patience));
  if (!sync) return std::optional<StepExposure>();
  exposure.sync = *sync;
  return std::optional(exposure);
}

Status Shooter::Expose(StepExposure& exposure) {
  if (mode_ == SyncMode::kFreeRunning) {
    // Settling takes no wait of its own: the stream's frames tell when it is over.
    last_trigger_ = exposure.pulse.time;
    ++camera_triggers_;
    return Status::Ok();
  }
  const MonotonicNs ready = std::max(exposure.sync + options_.settle, last_trigger_ + options_.camera.min_frame_period);
  SLX_RETURN_IF_ERROR(Pass(ready - devices_.light.Now()));
  SLX_ASSIGN_OR_RETURN(exposure.camera, devices_.lines.TriggerCamera());
  last_trigger_ = exposure.camera.time;
  // The bank's number may count the projectors' pulses, too; frames advance with the camera's own.
  exposure.number = camera_triggers_++;
  return Status::Ok();
}

Status Shooter::AwaitEnd(const StepExposure& exposure) {
  if (mode_ == SyncMode::kFreeRunning) return safe_();
  const MonotonicNs end =
      exposure.camera.time + FromMilliseconds(exposure.step->exposure_ms) + options_.camera.exposure_margin;
  return Pass(end - devices_.light.Now());
}

Status Shooter::Pass(nanoseconds time) {
  for (nanoseconds left = time; left.count() > 0; left -= kLongestUnasked) {
    SLX_RETURN_IF_ERROR(safe_());
    options_.wait(std::min(left, kLongestUnasked));
  }
  return safe_();
}

Result<Shot> Shooter::Collect(const StepExposure& exposure) {
  SLX_ASSIGN_OR_RETURN(Shot shot,
                       mode_ == SyncMode::kTriggered ? CollectTriggered(exposure) : CollectFromStream(exposure));
  const PlanStep& step = *exposure.step;
  FrameRecord& r = shot.record;
  r.step = step.index;
  r.projector = step.projector;
  r.phase = step.phase;
  r.pattern = step.pattern;
  r.bracket = step.bracket;
  r.retry = exposure.retry;
  r.sync_time = exposure.sync;
  return shot;
}

Result<Shot> Shooter::CollectTriggered(const StepExposure& exposure) {
  const PlanStep& step = *exposure.step;
  const TriggerReceipt camera_pulse{exposure.number, exposure.camera.time};
  std::optional<TriggerReceipt> next;
  if (!IsLast(exposure)) next = TriggerReceipt{exposure.number + 1, last_trigger_};
  const auto match = [&](const CapturedFrame& frame) {
    const ShotFault fault = pairing_.Match(camera_pulse, step.exposure_ms, frame);
    const bool moved_on =
        last_pulse_ > exposure.camera.time && frame.time + FromMilliseconds(frame.exposure_ms) > last_pulse_;
    if (fault != ShotFault::kNone || !moved_on) return fault;
    // Late, or the next one's where the camera passed over this trigger: numbers and triggers may no longer go
    // together.
    pairing_.TriggerLost();
    return ShotFault::kLateFrame;
  };
  const MonotonicNs due = exposure.camera.time + FromMilliseconds(step.exposure_ms);
  SLX_ASSIGN_OR_RETURN(Shot shot, AwaitFrame(exposure, due, next, match));
  shot.record.trigger_number = exposure.camera.number;
  shot.record.trigger_time = exposure.camera.time;
  return shot;
}

Status Shooter::PassOverStream() {
  while (true) {
    SLX_ASSIGN_OR_RETURN(const std::optional<CapturedFrame> frame, devices_.camera.Wait({}));
    if (!frame) return Status::Ok();
    // Each is counted and remembered; none is anybody's.
    static_cast<void>(pairing_.MatchStream(kNever, {}, *frame));
    static_cast<void>(rows_.ShareRepeated(frame->pixels));
    ++transition_frames_;
  }
}

Result<Shot> Shooter::CollectFromStream(const StepExposure& exposure) {
  const PlanStep& step = *exposure.step;
  const MonotonicNs settled = exposure.sync + options_.settle;
  const nanoseconds one_exposure = FromMilliseconds(step.exposure_ms);
  const nanoseconds window = watch_.FrameDeadline(exposure.patience) + one_exposure;
  SLX_ASSIGN_OR_RETURN(Shot shot, AwaitFrame(exposure, settled + 2 * one_exposure, {}, [&](const CapturedFrame& frame) {
                         ShotFault fault = pairing_.MatchStream(settled, window, frame);
                         // A new exposure reaches the stream some frames later.
                         if (fault == ShotFault::kNone && !HasExposure(step, frame)) fault = ShotFault::kOutOfOrder;
                         transition_frames_ += fault == ShotFault::kOutOfOrder;
                         return fault;
                       }));
  shot.record.trigger_number = exposure.pulse.number;
  shot.record.trigger_time = exposure.pulse.time;
  return shot;
}

Result<std::optional<MonotonicNs>> Shooter::AwaitSync(int projector, const TriggerReceipt& trigger, Patience patience) {
  std::vector<bool> seen(devices_.projectors.size(), projector >= 0);
  if (projector >= 0) seen[projector] = false;
  nanoseconds left = watch_.SyncDeadline(projector, patience);
  MonotonicNs latest{};
  while (std::find(seen.begin(), seen.end(), false) != seen.end()) {
    SLX_ASSIGN_OR_RETURN(
        const std::optional<SyncEdge> edge,
        (WaitSafely<SyncEdge>(left, safe_, [&](nanoseconds t) { return devices_.lines.WaitSync(t); })));
    if (!edge) return std::optional<MonotonicNs>();
    const bool known = edge->projector >= 0 && edge->projector < static_cast<int>(seen.size());
    if (!known || edge->time < trigger.time) continue;  // an edge of the past is not this pulse's answer
    if (!seen[edge->projector]) watch_.SawSync(edge->projector, edge->time - trigger.time);
    seen[edge->projector] = true;
    latest = std::max(latest, edge->time);
  }
  return std::optional<MonotonicNs>(latest);
}

Result<std::optional<CapturedFrame>> Shooter::NextFrame(MonotonicNs until, std::optional<MonotonicNs>& came) {
  std::optional<CapturedFrame> frame = std::exchange(early_, std::nullopt);
  if (frame) return frame;
  SLX_RETURN_IF_ERROR(safe_());
  SLX_ASSIGN_OR_RETURN(frame, devices_.camera.Wait({}));
  if (frame) return frame;
  nanoseconds left = std::max(nanoseconds(0), until - devices_.light.Now());
  SLX_ASSIGN_OR_RETURN(
      frame, (WaitSafely<CapturedFrame>(left, safe_, [&](nanoseconds t) { return devices_.camera.Wait(t); })));
  came = devices_.light.Now();
  return frame;
}

bool Shooter::WasGivenUp(const CapturedFrame& frame) {
  const auto its = std::find_if(given_up_.begin(), given_up_.end(), [&](const StepExposure& exposure) {
    const MonotonicNs trigger = exposure.camera.time;
    return frame.time >= trigger && frame.time <= trigger + options_.frame_slack;
  });
  if (its == given_up_.end()) return false;
  given_up_.erase(its);
  return true;
}

Result<Shot> Shooter::AwaitFrame(const StepExposure& exposure, MonotonicNs due,
                                 const std::optional<TriggerReceipt>& next,
                                 const std::function<ShotFault(const CapturedFrame&)>& match) {
  Shot shot;
  const MonotonicNs until = std::max(due + watch_.FrameDeadline(exposure.patience), devices_.light.Now() + kLeastWait);
  while (true) {
    std::optional<MonotonicNs> came;
    SLX_ASSIGN_OR_RETURN(std::optional<CapturedFrame> frame, NextFrame(until, came));
    if (frame && next && pairing_.IsOfNext(*next, *frame)) {
      early_ = std::move(frame);
      if (shot.fault == ShotFault::kNone) shot.fault = ShotFault::kLostFrame;
      return shot;
    }
    if (!frame) {
      pairing_.TriggerLost();
      if (mode_ == SyncMode::kTriggered) given_up_.push_back(exposure);
      if (given_up_.size() > kGivenUp) given_up_.pop_front();
      // A frame of the past is no answer: what was seen first stays the named cause.
      if (shot.fault == ShotFault::kNone) shot.fault = ShotFault::kLostFrame;
      return shot;
    }
    SLX_RETURN_IF_ERROR(CheckFrame(*frame));
    // Frames that are passed over may come back as old buffers, too: all are remembered.
    const bool repeats =
        options_.max_repeated_rows < 1.0 && rows_.ShareRepeated(frame->pixels) > options_.max_repeated_rows;
    const ShotFault fault = match(*frame);
    if (fault == ShotFault::kOutOfOrder && mode_ == SyncMode::kTriggered && WasGivenUp(*frame)) {
      watch_.SawLateFrame();
      continue;
    }
    if (fault == ShotFault::kOutOfOrder || fault == ShotFault::kDoubledFrame) {
      // In a stream, frames from before are no fault: they are the transition.
      if (mode_ == SyncMode::kTriggered || fault == ShotFault::kDoubledFrame) shot.fault = fault;
      continue;
    }
    if (fault == ShotFault::kNone) came ? watch_.SawFrame(*came - due) : watch_.HadFrame(devices_.light.Now() - due);
    if (shot.fault == ShotFault::kNone) shot.fault = fault;
    if (shot.fault == ShotFault::kNone && repeats) shot.fault = ShotFault::kRepeatedRows;
    if (shot.fault == ShotFault::kNone && !HasExposure(*exposure.step, *frame)) shot.fault = ShotFault::kWrongExposure;
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
    r.mean_dn = MeanDn(frame->pixels);
    shot.pixels = std::move(frame->pixels);
    return shot;
  }
}

bool Shooter::HasExposure(const PlanStep& step, const CapturedFrame& frame) const {
  return IsNear(frame.exposure_ms, step.exposure_ms, options_.exposure_tolerance) &&
         IsNear(frame.gain, options_.gain, options_.exposure_tolerance);
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

Result<ShotFault> Shooter::DrainEdges() {
  ShotFault fault = ShotFault::kNone;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const std::optional<SyncEdge> edge, devices_.lines.WaitSync({}));
    if (!edge) return fault;
    fault = ShotFault::kExtraSync;
  }
}

Result<ShotFault> Shooter::DrainFrames() {
  // A stream brings frames unasked; the next shot looks at their numbers and times.
  if (mode_ == SyncMode::kFreeRunning) return ShotFault::kNone;
  ShotFault first = ShotFault::kNone;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const std::optional<CapturedFrame> frame, devices_.camera.Wait({}));
    if (!frame) return first;
    if (WasGivenUp(*frame)) watch_.SawLateFrame();
    const ShotFault fault = pairing_.Unexpected(*frame);
    if (first == ShotFault::kNone) first = fault;
  }
}

Result<ShotFault> Shooter::Drain() {
  SLX_ASSIGN_OR_RETURN(const ShotFault edges, DrainEdges());
  SLX_ASSIGN_OR_RETURN(const ShotFault frames, DrainFrames());
  return edges != ShotFault::kNone ? edges : frames;
}

}  // namespace stratalux::rig
