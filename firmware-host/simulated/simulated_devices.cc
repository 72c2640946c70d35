// SPDX-License-Identifier: Apache-2.0
// Lines, projectors and the clock.
#include "firmware-host/simulated/simulated_devices.h"

#include <algorithm>
#include <iterator>
#include <string>
#include <utility>

#include "firmware-host/projector/memory_way.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr size_t kTimeline = 4;  // pictures of a projector that one exposure may see
constexpr size_t kFaultsRemembered = 65536;

}  // namespace

void SimulatedDevices::Show(size_t projector, MonotonicNs since) {
  ProjectorState& state = states_[projector];
  std::optional<Pattern> picture;
  if (state.enabled) picture = state.shown >= 0 ? state.memory[state.shown] : Pattern{};
  // What was to come later is overtaken: a light switched off before a slow projector shows its next picture.
  while (state.timeline.size() > 1 && state.timeline.back().since > since) state.timeline.pop_back();
  state.timeline.push_back({picture, since});
  if (state.timeline.size() > kTimeline) state.timeline.erase(state.timeline.begin());
  if (options_.free_running) return;  // its frames are exposed when they are asked for
  // Exposures under way see it, too. A rolling shutter's last row ends later.
  const CameraElectronics& camera = options_.devices.camera;
  const double rows_ms =
      camera.shutter == Shutter::kRolling ? 1e-3 * camera.line_time_us * calibration().camera.model.height : 0.0;
  auto add_to = [&](PendingFrame& frame) {
    std::vector<Shown>& timeline = frame.light.timeline[projector];
    while (timeline.size() > 1 && timeline.back().since > since) timeline.pop_back();
    if (since < frame.light.start + FromMilliseconds(frame.light.exposure_ms + rows_ms))
      timeline.push_back({picture, since});
  };
  for (PendingFrame& frame : pending_) add_to(frame);
  if (last_) add_to(*last_);
}

Status SimulatedDevices::StepTo(size_t projector, const std::vector<Pattern>& sequence) {
  if (sequence.empty()) return Status::Ok();
  ProjectorState& state = states_[projector];
  if (!IsFilled(projector)) {
    Rewind(projector);
    state.memory = sequence;
    ++fillings_;
    return Status::Ok();
  }
  const MemoryTiming timing = MemoryTimingOf(options_.devices.timing);
  const std::optional<MemoryWay> way = FindWay(state.memory, sequence, state.counted, timing);
  if (!way)
    return Status::Usage("the pattern memory of simulated projector " + std::to_string(projector) + " (" +
                         std::to_string(state.memory.size()) + " patterns) does not hold this sequence of " +
                         std::to_string(sequence.size()));
  if (way->start == WayStart::kReset) Rewind(projector);
  clock_ = clock_ + way->steps * timing.step;
  StepOn(state, way->steps);
  state.counted = way->target;
  Show(projector, clock_);
  return Status::Ok();
}

void SimulatedDevices::Rewind(size_t projector) {
  ProjectorState& state = states_[projector];
  clock_ = clock_ + FromMilliseconds(options_.devices.timing.memory_reset_ms);
  state.next = 0;
  state.counted = 0;
  state.shown = -1;
  Show(projector, clock_);
}

void SimulatedDevices::StepOn(ProjectorState& state, int64_t steps) const {
  const auto size = static_cast<int64_t>(state.memory.size());
  if (steps == 0 || size == 0) return;
  state.shown = (state.next + steps - 1) % size;
  state.next = (state.shown + 1) % size;
}

std::chrono::nanoseconds SimulatedDevices::Jittered(double ms) {
  const double jitter_us = options_.devices.timing.jitter_us;
  if (jitter_us <= 0.0) return FromMilliseconds(ms);
  Random random(options_.seed, (uint64_t{1} << 48) + static_cast<uint64_t>(jitters_++));
  return FromMilliseconds(std::max(0.0, ms + 1e-3 * jitter_us * random.Normal()));
}

void SimulatedDevices::Log(const Fault& fault, int64_t number) {
  if (injected_.size() == kFaultsRemembered) injected_.pop_front();
  injected_.push_back({fault.kind, number, 1e-9 * static_cast<double>((clock_ - kClockStart).count())});
}

void SimulatedDevices::TakeSwitches() {
  for (size_t p = 0; p < states_.size(); ++p) {
    const bool on = switches_[p].on();
    if (states_[p].enabled == on) continue;
    states_[p].enabled = on;
    Show(p, switches_[p].changed());
  }
}

Result<TriggerReceipt> SimulatedDevices::TriggerProjector(int projector) {
  const Turn turn(*this);
  if (lines_gone_.load()) return Status::Failed("simulated lines: the chip is gone (ENODEV)");
  const TriggerReceipt receipt{triggers_++, clock_};
  const int64_t pulse = pulses_++;
  int edges = 1, advance = 1;
  int counted = 1;  // by the kernel, which sees an edge that gets lost on its way to us
  for (const Fault& fault : faults_.AtPulse(pulse)) {
    Log(fault, pulse);
    if (fault.kind == FaultKind::kLinesGone) return Status::Failed("simulated lines: the chip is gone (ENODEV)");
    if (fault.kind == FaultKind::kEdgeLost || fault.kind == FaultKind::kSyncStuck) edges = 0;
    if (fault.kind == FaultKind::kSyncStuck) counted = 0;
    if (fault.kind == FaultKind::kEdgeDoubled) edges = counted = 2;
    if (fault.kind == FaultKind::kProjectorLag) advance = 0;
    if (fault.kind == FaultKind::kProjectorSkip) advance = 2;
    if (fault.kind == FaultKind::kEmergencyStop) Open(StopReason::kEmergencyStop);
    if (fault.kind == FaultKind::kDoorOpen) Open(StopReason::kDoorOpen);
  }
  for (size_t p = 0; p < states_.size(); ++p) {
    if (projector >= 0 && p != static_cast<size_t>(projector)) continue;
    ProjectorState& s = states_[p];
    if (IsFilled(p)) {
      StepOn(s, advance);
    } else {
      s.shown = std::min(s.shown + advance, static_cast<int64_t>(s.memory.size()) - 1);
    }
    if (s.counted) s.counted = (*s.counted + counted) % std::max<int64_t>(1, std::ssize(s.memory));
    const MonotonicNs light = clock_ + Jittered(options_.devices.timing.sync_delay_ms);
    Show(p, light);
    const auto later = std::upper_bound(edges_.begin(), edges_.end(), light,
                                        [](MonotonicNs time, const SyncEdge& edge) { return time < edge.time; });
    std::vector<SyncEdge> answer;
    for (int k = 0; k < edges; ++k) answer.push_back({static_cast<int>(p), edge_number_++, light});
    edges_.insert(later, answer.begin(), answer.end());
    if (edges == 0) ++edge_number_;  // the kernel counted it
  }
  return receipt;
}

Result<std::optional<SyncEdge>> SimulatedDevices::WaitSync(std::chrono::nanoseconds timeout) {
  const Turn turn(*this);
  if (edges_.empty() || edges_.front().time > clock_ + timeout) {
    clock_ = clock_ + timeout;
    return std::optional<SyncEdge>();
  }
  const SyncEdge edge = edges_.front();
  edges_.pop_front();
  if (clock_ < edge.time) clock_ = edge.time;
  return std::optional(edge);
}

}  // namespace stratalux::rig
