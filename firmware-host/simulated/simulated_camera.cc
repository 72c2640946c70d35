// SPDX-License-Identifier: Apache-2.0
// The camera: what it exposes, when, and what becomes of the frame.
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "firmware-host/simulated/simulated_devices.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr double kDefaultLateMs = 200.0, kDefaultSlowMs = 60.0, kDefaultMoveMm = 2.0, kDefaultSwayMm = 0.5,
                 kDefaultDrift = 0.9, kDefaultBlink = 0.8;
constexpr size_t kFramesRemembered = 65536;
constexpr double kWholeShare = 0.98;  // of an exposure that a picture must fill to be the one shown

// Row from which on a spoilt picture is wrong.
int FirstSpoiltRow(int64_t number, int height) {
  return static_cast<int>(Random(0x7ea2, static_cast<uint64_t>(number)).Uniform(0.2, 0.8) * height);
}

// Bytes of a line went missing: what follows stands elsewhere.
void ShiftRows(Image<uint16_t>& pixels, int64_t number) {
  const double share = Random(0x7ea2, static_cast<uint64_t>(number) ^ (uint64_t{1} << 40)).Uniform(0.1, 0.4);
  const int shift = 2 * static_cast<int>(share * pixels.width());
  for (int y = FirstSpoiltRow(number, pixels.height()); y < pixels.height(); ++y)
    std::rotate(pixels.row(y), pixels.row(y) + shift % pixels.width(), pixels.row(y) + pixels.width());
}

double LateBy(const Fault& fault) { return fault.value != 0.0 ? fault.value : kDefaultLateMs; }

// Half a sine over the fault's exposures, in steps of half its height: each place costs a new light transport.
Eigen::Vector3d SwayAt(const Fault& fault, int64_t number) {
  const double phase = static_cast<double>(number - fault.at + 1) / static_cast<double>(fault.count + 1);
  const double height = fault.value != 0.0 ? fault.value : kDefaultSwayMm;
  return height * 0.5 * std::round(2.0 * std::sin(std::numbers::pi * phase)) *
         Eigen::Vector3d(fault.along[0], fault.along[1], fault.along[2]).normalized();
}

}  // namespace

PendingFrame SimulatedDevices::Expose() {
  PendingFrame frame;
  frame.number = frame_number_++;
  frame.time = clock_ + Jittered(options_.devices.timing.shutter_delay_ms);
  frame.exposure_ms = exposure_ms_;
  frame.light = {frame.time, exposure_ms_, gain_, frame.number, {}, push_mm_, light_};
  for (const ProjectorState& s : states_) frame.light.timeline.push_back(s.timeline);
  last_start_ = frame.time;
  exposed_ = frame.time + FromMilliseconds(exposure_ms_);
  free_from_ = exposed_ + Jittered(options_.devices.timing.readout_ms);
  frame.ready = free_from_;
  return frame;
}

// One more than was asked for, of the same light: the driver hands out both.
PendingFrame SimulatedDevices::ExtraFrame(const PendingFrame& frame) {
  PendingFrame extra = frame;
  extra.number = frame_number_++;
  extra.light.number = extra.number;
  extra.time = frame.ready;
  // A stream's frame was exposed when it says so: whoever goes by its time may take it.
  if (options_.free_running) extra.light.start = extra.time;
  extra.picture = Picture::kSound;
  extra.device_error = false;
  return extra;
}

// An exposure's charge needs a place to go when it ends: the frame before must have been read out by then.
bool SimulatedDevices::TakesTrigger() const {
  const RigTiming& timing = options_.devices.timing;
  if (!last_start_) return true;
  const MonotonicNs start = clock_ + FromMilliseconds(timing.shutter_delay_ms);
  if (start < *last_start_ + FromMilliseconds(timing.min_frame_period_ms)) return false;
  if (!timing.overlapped_readout) return clock_ >= free_from_;
  return clock_ >= exposed_ && start + FromMilliseconds(exposure_ms_) >= free_from_;
}

ShownFrame SimulatedDevices::TruthOf(const PendingFrame& frame) const {
  ShownFrame truth;
  truth.exposure = frame.light.number;
  truth.whole = true;
  truth.exposure_ms = frame.light.exposure_ms;
  truth.push_mm = frame.light.push_mm;
  truth.light = frame.light.light;
  for (size_t p = 0; p < frame.light.timeline.size(); ++p) {
    const std::vector<Shown>& timeline = frame.light.timeline[p];
    const std::vector<double> shares =
        ShareOfPictures(timeline, frame.light.start, frame.light.exposure_ms, options_.devices.ForProjector(p).lag_ms);
    const size_t most = std::max_element(shares.begin(), shares.end()) - shares.begin();
    double share = 0.0;  // the same picture may have been switched on twice
    for (size_t k = 0; k < shares.size(); ++k)
      if (timeline[k].pattern == timeline[most].pattern) share += shares[k];
    truth.whole = truth.whole && share >= kWholeShare;
    truth.pictures.push_back(timeline[most].pattern);
  }
  return truth;
}

void SimulatedDevices::Deliver(PendingFrame frame) {
  last_ = frame;
  if (started_) pending_.push_back(std::move(frame));
}

Result<TriggerReceipt> SimulatedDevices::TriggerCamera() {
  const Turn turn(*this);
  if (lines_gone_.load()) return Status::Failed("simulated lines: the chip is gone (ENODEV)");
  const TriggerReceipt receipt{triggers_++, clock_};
  if (options_.free_running) return receipt;
  if (TakesTrigger())
    ExposeWithFaults();
  else
    ++ignored_triggers_;
  return receipt;
}

bool SimulatedDevices::Remember(const PendingFrame& frame) {
  const bool first = shown_.try_emplace(frame.number, TruthOf(frame)).second;
  if (shown_.size() > kFramesRemembered) shown_.erase(shown_.begin());
  return first;
}

void SimulatedDevices::ExposeWithFaults() {
  const int64_t number = exposures_++;
  const std::vector<Fault> faults = faults_.AtExposure(number);
  for (const Fault& fault : faults) {  // what changes the scene comes first
    if (fault.kind == FaultKind::kSubjectMoved && number == fault.at)
      push_mm_.x() += fault.value != 0.0 ? fault.value : kDefaultMoveMm;
    if (fault.kind == FaultKind::kLampDrift && number == fault.at)
      light_ *= fault.value != 0.0 ? fault.value : kDefaultDrift;
  }
  const std::optional<PendingFrame> before = last_;
  PendingFrame frame = Expose();
  int copies = 1;
  bool extra = false;
  for (const Fault& fault : faults) {
    Log(fault, number);
    if (fault.kind == FaultKind::kFrameLost) copies = 0;
    if (fault.kind == FaultKind::kFrameDoubled) copies = 2;
    if (fault.kind == FaultKind::kFrameExtra) extra = true;
    if (fault.kind == FaultKind::kFrameLate && !options_.free_running)
      frame.time = frame.time + FromMilliseconds(LateBy(fault));
    if (fault.kind == FaultKind::kFrameStale && before) {
      const MonotonicNs ready = frame.ready;
      frame = *before;
      frame.ready = ready;
    }
    if (fault.kind == FaultKind::kFrameFrozen && before) frame.light = before->light;
    if (fault.kind == FaultKind::kFrameCorrupt) frame.picture = Picture::kShiftedAndFlagged;
    if (fault.kind == FaultKind::kFrameGarbled) frame.picture = Picture::kShifted;
    if (fault.kind == FaultKind::kFrameTorn && before) {
      frame.picture = Picture::kTorn;
      frame.remains = before->light;
    }
    if (fault.kind == FaultKind::kExposureLatch) frame.light.exposure_ms = last_exposure_ms_;
    if (fault.kind == FaultKind::kSubjectSwayed) frame.light.push_mm += SwayAt(fault, number);
    if (fault.kind == FaultKind::kLampBlink) frame.light.light *= fault.value != 0.0 ? fault.value : kDefaultBlink;
    if (fault.kind == FaultKind::kCameraGone) frame.device_error = true;
    if (fault.kind == FaultKind::kFrameSlow)
      frame.ready = frame.ready + FromMilliseconds(fault.value != 0.0 ? fault.value : kDefaultSlowMs);
  }
  for (int k = 0; k < copies; ++k) Deliver(frame);
  if (copies == 0) last_ = frame;
  if (extra) Deliver(ExtraFrame(frame));
}

// A stream's frames show what is on when they say that they began, whoever asked for them: where one begins late, the
// stream stalls.
MonotonicNs SimulatedDevices::NextOfStream() {
  if (std::exchange(stall_looked_at_, exposures_) == exposures_) return next_frame_;
  for (const Fault& fault : faults_.AtExposure(exposures_))
    if (fault.kind == FaultKind::kFrameLate) next_frame_ = next_frame_ + FromMilliseconds(LateBy(fault));
  return next_frame_;
}

void SimulatedDevices::StreamUntil(MonotonicNs until) {
  const MonotonicNs now = clock_;
  const double busy_ms = exposure_ms_ + options_.devices.timing.readout_ms;
  const auto period = FromMilliseconds(std::max(options_.devices.timing.frame_period_ms, busy_ms));
  while (NextOfStream() + FromMilliseconds(busy_ms) <= until) {
    clock_ = next_frame_;
    next_frame_ = next_frame_ + period;
    ExposeWithFaults();
  }
  clock_ = now;
}

Result<Image<uint16_t>> SimulatedDevices::Develop(const Exposure& light) {
  const std::lock_guard lock(world_mutex_);
  SLX_ASSIGN_OR_RETURN(Image<float> perfect, world_.Light(light));
  return sensor_.Expose(std::move(perfect), {light.exposure_ms, light.gain, light.number});
}

double SimulatedDevices::ShareChanged(const Image<uint16_t>& a, const Image<uint16_t>& b) const {
  const CameraElectronics& e = options_.devices.camera;
  int64_t changed = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    const double x = a.data()[i], y = b.data()[i];
    const double variance = (x + y) / e.gain_e_per_dn + 2.0 * e.read_noise_dn * e.read_noise_dn;
    changed += (x - y) * (x - y) > 36.0 * variance;
  }
  return static_cast<double>(changed) / static_cast<double>(a.size());
}

void SimulatedDevices::PassTime(std::chrono::nanoseconds timeout) {
  const MonotonicNs deadline = clock_ + timeout;
  if (options_.free_running && started_ && pending_.empty()) {
    const MonotonicNs ready = NextOfStream() + FromMilliseconds(exposure_ms_ + options_.devices.timing.readout_ms);
    const MonotonicNs until = std::max(clock_, std::min(ready, deadline));
    StreamUntil(until);
    clock_ = until;
    return;
  }
  clock_ = pending_.empty() ? deadline : std::max(clock_, std::min(pending_.front().ready, deadline));
}

Result<std::optional<CapturedFrame>> SimulatedDevices::Wait(std::chrono::nanoseconds timeout) {
  PendingFrame pending;
  bool comes_first = false;
  {
    const Turn turn(*this);
    SLX_RETURN_IF_ERROR(CheckCamera());
    PassTime(timeout);
    if (pending_.empty() || clock_ < pending_.front().ready) return std::optional<CapturedFrame>();
    pending = std::move(pending_.front());
    pending_.pop_front();
    comes_first = Remember(pending);
  }
  if (pending.device_error) return Status::Failed("simulated camera: the device is gone (ENODEV)");
  CapturedFrame frame;
  SLX_ASSIGN_OR_RETURN(frame.pixels, Develop(pending.light));
  const Image<uint16_t> sound = pending.picture != Picture::kSound ? frame.pixels : Image<uint16_t>();
  if (pending.picture == Picture::kTorn) {
    SLX_ASSIGN_OR_RETURN(const Image<uint16_t> old, Develop(*pending.remains));
    const int first = FirstSpoiltRow(pending.number, old.height());
    std::copy(old.row(first), old.row(0) + old.size(), frame.pixels.row(first));
  } else if (pending.picture != Picture::kSound) {
    ShiftRows(frame.pixels, pending.number);
  }
  if (!sound.empty() && comes_first) {
    const std::lock_guard lock(mutex_);
    const auto found = shown_.find(pending.number);
    if (found != shown_.end()) found->second.spoilt = ShareChanged(sound, frame.pixels);
  }
  frame.cfa = calibration().camera.cfa;
  frame.sequence = pending.number;
  frame.time = pending.time;
  frame.clock = ClockSource::kSimulated;
  frame.exposure_ms = pending.exposure_ms;
  frame.gain = pending.light.gain;
  frame.corrupt = pending.picture == Picture::kShiftedAndFlagged;
  return std::optional(std::move(frame));
}

}  // namespace stratalux::rig
