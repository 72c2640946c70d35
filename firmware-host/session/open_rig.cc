// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/open_rig.h"

#include <string>
#include <utility>

#include "firmware-host/camera/libcamera_frame_source.h"
#include "firmware-host/camera/v4l2_frame_source.h"
#include "firmware-host/gpio/gpiod_line_bank.h"
#include "firmware-host/projector/display_line_bank.h"
#include "firmware-host/projector/kms_display.h"
#include "firmware-host/projector/pattern_memory_projector.h"
#include "firmware-host/session/last_lights.h"

namespace stratalux::rig {
namespace {

Result<std::unique_ptr<FrameSource>> OpenCamera(const CameraWiring& wiring, Logger& logger) {
  switch (wiring.backend) {
    case CameraBackend::kV4l2:
      return V4l2FrameSource::Open(wiring, logger);
    case CameraBackend::kLibcamera:
      return LibcameraFrameSource::Open(wiring, logger);
    case CameraBackend::kNone:
      break;
  }
  return Status::Usage("the configuration names no camera ([camera] backend); --simulate runs the simulated rig");
}

// In place of a camera that could not be opened again.
class NoCamera final : public FrameSource {
 public:
  NoCamera(CameraPace pace, Status why) : pace_(pace), why_(std::move(why)) {}
  [[nodiscard]] bool follows_trigger() const override { return pace_ == CameraPace::kTriggered; }
  Status Start() override { return why_; }
  Status Stop() override { return Status::Ok(); }
  Status SetExposure(double /*exposure_ms*/, double /*gain*/) override { return why_; }
  Result<std::optional<CapturedFrame>> Wait(std::chrono::nanoseconds /*timeout*/) override { return why_; }

 private:
  const CameraPace pace_;
  const Status why_;
};

Result<std::unique_ptr<NodeWatch>> WatchCamera(const CameraWiring& wiring, RigEvents& events) {
  WatchedDevice camera;
  camera.signal = RigSignal::kCamera;
  const bool v4l2 = wiring.backend == CameraBackend::kV4l2;
  camera.prefix = v4l2 ? "video" : "media";
  camera.is_there = [wiring, v4l2] {
    return v4l2 ? V4l2FrameSource::IsThere(wiring) : LibcameraFrameSource::IsThere(wiring);
  };
  return NodeWatch::Start("/dev", std::move(camera), events);
}

std::unique_ptr<Projector> OpenMemory(const RigConfig& config, const MemoryLayout& layout, int index,
                                      GpiodLineBank& lines, const StopToken& stop) {
  PatternMemoryOptions options;
  options.projector = index;
  options.width = config.plan.projector_width;
  options.height = config.plan.projector_height;
  options.memory = layout.projectors[index].patterns;
  options.timing = *MemoryTimingsOf(config)[static_cast<size_t>(index)];
  options.sync_deadline = config.LongestDeadline();
  return MakePatternMemoryProjector(lines, lines, std::move(options), stop);
}

// The displays among the projectors, in order.
Result<std::vector<std::unique_ptr<Display>>> OpenDisplays(const RigConfig& config) {
  std::vector<DisplayWiring> wirings;
  for (const ProjectorWiring& projector : config.projectors) {
    if (projector.kind != ProjectorKind::kDisplay) continue;
    DisplayWiring& wiring = wirings.emplace_back(projector.display);
    if (wiring.width == 0) wiring.width = config.plan.projector_width;
    if (wiring.height == 0) wiring.height = config.plan.projector_height;
  }
  return OpenKmsDisplays(wirings);
}

// Lights by projector: its ENABLE line, its display's picture.
using Lights = std::vector<std::vector<LightSwitch*>>;

Status OpenProjectors(const RigConfig& config, const MemoryLayout& layout, GpiodLineBank* lines, const StopToken& stop,
                      OpenedRig& rig, Lights& lights) {
  SLX_ASSIGN_OR_RETURN(std::vector<std::unique_ptr<Display>> displays, OpenDisplays(config));
  std::vector<DisplayOfProjector> of_projector;
  auto display = displays.begin();
  for (int p = 0; p < static_cast<int>(config.projectors.size()); ++p) {
    DisplayOfProjector& wired = of_projector.emplace_back();
    std::vector<LightSwitch*>& switches = lights.emplace_back();
    LightSwitch* enable = rig.gpio_lights ? rig.gpio_lights->enable(p) : nullptr;
    if (enable != nullptr) switches.push_back(enable);
    if (config.projectors[p].kind == ProjectorKind::kMemory) {
      rig.projectors.push_back(OpenMemory(config, layout, p, *lines, stop));
      continue;
    }
    wired.display = display->get();
    wired.latency = FromMilliseconds(config.projectors[p].display.latency_ms);
    switches.push_back(&wired.display->light());
    rig.projectors.push_back(std::move(*display++));
  }
  if (!displays.empty()) rig.display_lines = std::make_unique<DisplayLineBank>(lines, std::move(of_projector));
  return Status::Ok();
}

}  // namespace

RigDevices OpenedRig::devices() const {
  if (simulation) return {*light, simulation->lines(), simulation->camera(), simulation->projectors()};
  std::vector<Projector*> list;
  for (const std::unique_ptr<Projector>& projector : projectors) list.push_back(projector.get());
  return {*light, display_lines ? *display_lines : *wired_lines, *camera, list};
}

std::function<void(std::chrono::nanoseconds)> OpenedRig::wait() const {
  if (simulation) return [rig = simulation.get()](std::chrono::nanoseconds time) { rig->Sleep(time); };
  return {};
}

Status OpenedRig::ReopenCamera(const CameraWiring& wiring, Logger& logger) {
  if (simulation) {
    SLX_RETURN_IF_ERROR(simulation->ReopenCamera());
  } else {
    camera.reset();  // it may hold what the next one needs
    Result<std::unique_ptr<FrameSource>> opened = OpenCamera(wiring, logger);
    if (!opened.ok()) {
      camera = std::make_unique<NoCamera>(wiring.pace, opened.status());
      return opened.status();
    }
    camera = std::move(opened).value();
  }
  events->Tell(RigSignal::kCamera, SignalLevel::kRest, MonotonicNow());
  return Status::Ok();
}

Result<std::unique_ptr<FrameSource>> OpenCameraAtStart(const CameraWiring& wiring, CameraAtStart at_start,
                                                       RigEvents& events, Logger& logger) {
  Result<std::unique_ptr<FrameSource>> camera = OpenCamera(wiring, logger);
  // Another start would find the same. What the camera itself says may be otherwise soon: one that settles, a second
  // one that goes.
  const bool hopeless = wiring.backend == CameraBackend::kNone ||
                        (wiring.backend == CameraBackend::kLibcamera && !LibcameraFrameSource::IsBuilt());
  if (camera.ok() || hopeless || at_start == CameraAtStart::kNeeded) return camera;
  logger.Warning("running without a camera until one appears: " + camera.status().message());
  events.Tell(RigSignal::kCamera, SignalLevel::kActive, MonotonicNow());
  return std::unique_ptr<FrameSource>(std::make_unique<NoCamera>(wiring.pace, camera.status()));
}

Result<OpenedRig> OpenRig(const RigConfig& config, const std::optional<SimulatedRigOptions>& simulated, StopToken& stop,
                          Logger& logger, CameraAtStart at_start) {
  SLX_ASSIGN_OR_RETURN(const MemoryLayout layout, LayOutMemories(config.plan, config.memory));
  OpenedRig rig;
  rig.events = std::make_unique<RigEvents>(stop);
  if (simulated) {
    SimulatedRigOptions options = *simulated;
    options.stop = &stop;
    options.memories = layout.Patterns();
    options.events = rig.events.get();
    SLX_ASSIGN_OR_RETURN(rig.simulation, SimulatedRig::Create(options, logger));
    SLX_ASSIGN_OR_RETURN(rig.light, GuardLight(*rig.simulation, stop));
    if (!options.control_pipe.empty()) {
      SLX_ASSIGN_OR_RETURN(rig.control, ControlPipe::Open(options.control_pipe, *rig.simulation, logger));
    }
    return rig;
  }
  if (config.projectors.empty())
    return Status::Usage(
        "the configuration wires no devices ([gpio], [camera] backend, [[projector]]); --simulate runs the simulated "
        "rig");
  GpiodLineBank* lines = nullptr;
  if (!config.gpio.empty()) {
    SLX_ASSIGN_OR_RETURN(rig.gpio_lights, GpioLights::Open(config.gpio, rig.events.get()));
    SLX_ASSIGN_OR_RETURN(std::unique_ptr<GpiodLineBank> bank,
                         GpiodLineBank::Open(config.gpio, logger, rig.events.get()));
    lines = bank.get();
    rig.wired_lines = std::move(bank);
  }
  Lights lights;
  SLX_RETURN_IF_ERROR(OpenProjectors(config, layout, lines, stop, rig, lights));
  InterlockInput* interlock = rig.gpio_lights ? rig.gpio_lights->interlock() : nullptr;
  SLX_ASSIGN_OR_RETURN(rig.light, LightGuard::Start(std::move(lights), interlock, stop));
  if (!rig.light->realtime())
    logger.Warning(
        "the light's guard has no right to SCHED_FIFO and competes with other programs (LimitRTPRIO, "
        "docs/rig-safety.md)");
  if (!config.gpio.emergency_stop)
    logger.Warning("no E-STOP is wired ([gpio] emergency_stop): nobody but the operator can stop the light");
  if (!config.gpio.door) logger.Warning("no door is wired ([gpio] door): light can go on while the box is open");
  if (const Status kept = KeepLights(StateFolder(), LightsOf(config)); !kept.ok())
    logger.Warning("`stratalux-rig safe` will need the configuration: " + kept.message());
  SLX_ASSIGN_OR_RETURN(rig.camera, OpenCameraAtStart(config.camera, at_start, *rig.events, logger));
  Result<std::unique_ptr<NodeWatch>> watch = WatchCamera(config.camera, *rig.events);
  if (!watch.ok()) logger.Warning("unplugging the camera will not be noticed: " + watch.status().message());
  if (watch.ok()) rig.camera_watch = std::move(watch).value();
  return rig;
}

}  // namespace stratalux::rig
