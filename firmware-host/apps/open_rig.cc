// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/open_rig.h"

#include <string>
#include <thread>
#include <utility>

#include "firmware-host/camera/v4l2_frame_source.h"
#include "firmware-host/gpio/gpiod_line_bank.h"
#include "firmware-host/projector/pattern_memory_projector.h"

namespace stratalux::rig {
namespace {

Result<std::unique_ptr<FrameSource>> OpenCamera(const CameraWiring& wiring, Logger& logger) {
  switch (wiring.backend) {
    case CameraBackend::kV4l2:
      return V4l2FrameSource::Open(wiring, logger);
    case CameraBackend::kLibcamera:
      return Status::Usage("[camera] backend = \"libcamera\": this program was built without libcamera");
    case CameraBackend::kNone:
      break;
  }
  return Status::Usage("the configuration names no camera ([camera] backend); --simulate runs the simulated rig");
}

Result<std::unique_ptr<Projector>> OpenProjector(const RigConfig& config, const CapturePlan& plan, int index,
                                                 GpiodLineBank& lines) {
  if (config.projectors[index].kind == ProjectorKind::kDisplay)
    return Status::Usage("[[projector]] " + std::to_string(index) +
                         ": kind = \"display\": this program was built without displays");
  PatternMemoryOptions options;
  options.projector = index;
  options.width = config.plan.projector_width;
  options.height = config.plan.projector_height;
  options.memory = MemoryOf(plan, index);
  options.rewind = config.gpio.projectors[index].reset ? MemoryRewind::kResetLine : MemoryRewind::kStepAround;
  options.sync_deadline = std::chrono::nanoseconds(static_cast<int64_t>(config.deadline_ms * 1e6));
  return MakePatternMemoryProjector(lines, lines, std::move(options));
}

}  // namespace

RigDevices OpenedRig::devices() const {
  if (simulation) return {simulation->lines(), simulation->camera(), simulation->projectors()};
  std::vector<Projector*> list;
  for (const std::unique_ptr<Projector>& projector : projectors) list.push_back(projector.get());
  return {*lines, *camera, list};
}

std::function<void(std::chrono::nanoseconds)> OpenedRig::wait() const {
  if (simulation) return [rig = simulation.get()](std::chrono::nanoseconds time) { rig->Sleep(time); };
  return [](std::chrono::nanoseconds time) { std::this_thread::sleep_for(time); };
}

Result<OpenedRig> OpenRig(const RigConfig& config, const CapturePlan& plan,
                          const std::optional<SimulatedRigOptions>& simulated, Logger& logger) {
  OpenedRig rig;
  if (simulated) {
    SLX_ASSIGN_OR_RETURN(rig.simulation, SimulatedRig::Create(*simulated, logger));
    return rig;
  }
  if (config.projectors.empty())
    return Status::Usage(
        "the configuration wires no devices ([gpio], [camera] backend, [[projector]]); --simulate runs the simulated "
        "rig");
  SLX_ASSIGN_OR_RETURN(std::unique_ptr<GpiodLineBank> bank, GpiodLineBank::Open(config.gpio, logger));
  GpiodLineBank& lines = *bank;
  rig.lines = std::move(bank);
  SLX_ASSIGN_OR_RETURN(rig.camera, OpenCamera(config.camera, logger));
  for (int p = 0; p < static_cast<int>(config.projectors.size()); ++p) {
    SLX_ASSIGN_OR_RETURN(rig.projectors.emplace_back(), OpenProjector(config, plan, p, lines));
  }
  return rig;
}

}  // namespace stratalux::rig
