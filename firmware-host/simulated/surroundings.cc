// SPDX-License-Identifier: Apache-2.0
// What happens around the simulated rig: door, E-STOP, START, plugs.
#include <cerrno>

#include <sys/eventfd.h>
#include <unistd.h>

#include "firmware-host/simulated/simulated_devices.h"
#include "shared/base/check.h"

namespace stratalux::rig {

UniqueFd SimulatedDevices::NewEvent() {
  UniqueFd event(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  SLX_CHECK(event.ok());
  return event;
}

StopReason SimulatedDevices::Take() noexcept {
  uint64_t count = 0;
  while (read(changed_.get(), &count, sizeof count) < 0 && errno == EINTR) {
  }
  if (const StopReason opened = opened_.exchange(StopReason::kNone); opened != StopReason::kNone) return opened;
  if (lines_gone_.load()) return StopReason::kLinesGone;
  if (emergency_stop_.load()) return StopReason::kEmergencyStop;
  return door_open_.load() ? StopReason::kDoorOpen : StopReason::kNone;
}

void SimulatedDevices::Open(StopReason reason) noexcept {
  opened_.store(reason);
  const RigSignal signal = reason == StopReason::kDoorOpen ? RigSignal::kDoor : RigSignal::kEmergencyStop;
  if (options_.events != nullptr) options_.events->TellMoment(signal, MonotonicNow());
}

void SimulatedDevices::Happen(RigSignal signal, SignalLevel level) {
  const bool active = level == SignalLevel::kActive;
  switch (signal) {
    case RigSignal::kStart:
      if (active && !lines_gone_.load() && options_.events != nullptr) options_.events->PressStart(MonotonicNow());
      return;
    case RigSignal::kDoor:
      // A moment between two looks counts, as on a line that keeps its edges.
      if (active) opened_.store(StopReason::kDoorOpen);
      door_open_.store(active);
      break;
    case RigSignal::kEmergencyStop:
      if (active) opened_.store(StopReason::kEmergencyStop);
      emergency_stop_.store(active);
      break;
    case RigSignal::kCamera:
      camera_gone_.store(active);
      // Told first: what stops the capture is the plug, not the first error that comes of it.
      Tell(signal, level);
      if (active) camera_broken_.store(true);
      return;
    case RigSignal::kLines:
      lines_gone_.store(active);
      break;
  }
  const uint64_t one = 1;
  // Refused only where the counter is full: then it is readable.
  static_cast<void>(!write(changed_.get(), &one, sizeof one));
  Tell(signal, level);
}

Status SimulatedDevices::CheckCamera() const {
  if (!camera_broken_.load()) return Status::Ok();
  return Status::Failed("simulated camera: the device is gone (ENODEV)");
}

Status SimulatedDevices::ReopenCamera() {
  const Turn turn(*this);
  if (camera_gone_.load())
    return Status::NotFound("simulated camera: it is unplugged; plug it in (`plug camera` into the control pipe)");
  started_ = false;
  pending_.clear();
  camera_broken_.store(false);
  return Status::Ok();
}

}  // namespace stratalux::rig
