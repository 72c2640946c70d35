// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/config/rig_config.h"

#include <algorithm>
#include <utility>

#include "shared/config/toml_reader.h"

namespace stratalux::rig {
namespace {

Status ReadPlan(TomlTable plan, PlanOptions& o) {
  std::string kind = ToString(o.kind), sync = ToString(o.sync_mode), code = ToString(o.code);
  plan.Get("kind", kind);
  plan.Get("sync_mode", sync);
  plan.Get("projectors", o.projectors, 1, 16);
  plan.Get("projector_width", o.projector_width, 16, 8192);
  plan.Get("projector_height", o.projector_height, 16, 8192);
  plan.Get("exposure_ms", o.exposure_ms, 0.01, 10000);
  plan.Get("brackets", o.brackets, 0.001, 1000);
  plan.Get("reference_brackets", o.reference_brackets, 0.001, 1000);
  plan.Get("correspondence_brackets", o.correspondence_brackets, 0.001, 1000);
  plan.Get("separation_brackets", o.separation_brackets, 0.001, 1000);
  plan.Get("spot_brackets", o.spot_brackets, 0.001, 1000);
  plan.Get("code", code);
  plan.Get("preroll_markers", o.preroll_markers, 0, 64);
  plan.Get("separation_period", o.separation_period, 3, 8192);
  plan.Get("separation_shifts", o.separation_shifts, 3, 64);
  plan.Get("checkerboard", o.checkerboard);
  plan.Get("checkerboard_period", o.checkerboard_period, 2, 8192);
  plan.Get("checkerboard_shifts", o.checkerboard_shifts, 1, 64);
  plan.Get("comb_width", o.comb_width, 1, 1024);
  plan.Get("comb_period", o.comb_period, 2, 8192);
  plan.Get("comb_step", o.comb_step, 1, 1024);
  plan.Get("row_sweep", o.row_sweep);
  plan.Get("motion_whites", o.motion_whites, 0, 64);
  plan.Get("spot_radius", o.spot_radius, 0, 256);
  plan.Get("spot_pitch", o.spot_pitch, 2, 8192);
  plan.Get("second_takes", o.second_takes);
  plan.Get("guards", o.guards, 0, 16);
  SLX_ASSIGN_OR_RETURN(o.kind, ParseSessionKind(kind).WithContext(plan.Where("kind")));
  SLX_ASSIGN_OR_RETURN(o.sync_mode, ParseSyncMode(sync).WithContext(plan.Where("sync_mode")));
  SLX_ASSIGN_OR_RETURN(o.code, ParseColumnCode(code).WithContext(plan.Where("code")));
  return Status::Ok();
}

// LayOutMemories says whether it can be held.
Status ReadMemory(TomlTable memory, MemoryOptions& o) {
  std::vector<std::string> names;
  memory.Get("sections", names);
  memory.Get("capacity", o.capacity, 0, kLargestMemory);
  o.where = memory.Where("capacity");
  if (memory.Has("sections") && names.empty())
    return Status::Usage(
        memory.Where("sections") +
        ": memory.sections = []: name at least one section, or leave the key out to hold all that fit");
  for (const std::string& name : names) {
    SLX_ASSIGN_OR_RETURN(const MemorySection section,
                         ParseMemorySection(name).WithContext(memory.Where("sections") + ": memory.sections"));
    o.sections.push_back(section);
  }
  return Status::Ok();
}

// Every member of an enumeration whose values count from 0, in order.
template <typename T>
void GetWord(TomlTable& table, const std::string& key, T& value, const std::vector<std::string>& words) {
  auto index = static_cast<size_t>(value);
  table.GetWord(key, index, words);
  value = static_cast<T>(index);
}

// Unset where the table does not say.
void GetOptional(TomlTable& table, const std::string& key, std::optional<double>& value, double low, double high) {
  if (table.Has(key)) table.Get(key, value.emplace(low), low, high);
}

void GetMicroseconds(TomlTable& table, const std::string& key, std::chrono::microseconds& value, int low, int high) {
  auto us = static_cast<int>(value.count());
  table.Get(key, us, low, high);
  value = std::chrono::microseconds(us);
}

// { line = "GPIO17" } or { chip = "pinctrl-rp1", offset = 17 }; `chip` defaults to that of [gpio].
Status ReadAddress(TomlTable& line, const std::string& chip, LineAddress& at) {
  line.Get("line", at.name);
  line.Get("chip", at.chip = chip);
  line.Get("offset", at.offset, 0, 1023);
  if (at.name.empty() == !line.Has("offset"))
    return Status::Usage(line.Where() + ": give a line either by `line` (its name) or by `offset` on a chip");
  if (at.name.empty() && at.chip.empty())
    return Status::Usage(line.Where("offset") +
                         ": an offset needs the label of its chip: `chip` here or in [gpio] (`gpiodetect` lists them)");
  return Status::Ok();
}

Status ReadOutput(TomlTable& table, const std::string& key, const std::string& chip,
                  std::optional<OutputWiring>& output) {
  if (!table.Has(key)) return Status::Ok();
  TomlTable line = table.Table(key);
  output.emplace();
  GetWord(line, "active", output->active, {"high", "low"});
  return ReadAddress(line, chip, output->at);
}

Status ReadInput(TomlTable& table, const std::string& key, const std::string& chip, std::optional<InputWiring>& input) {
  if (!table.Has(key)) return Status::Ok();
  TomlTable line = table.Table(key);
  input.emplace();
  GetWord(line, "active", input->active, {"high", "low"});
  GetWord(line, "bias", input->bias, {"as-is", "disabled", "pull-up", "pull-down"});
  GetMicroseconds(line, "debounce_us", input->debounce, 0, 1'000'000);
  return ReadAddress(line, chip, input->at);
}

Status ReadGpio(TomlTable gpio, std::string& chip, GpioWiring& wiring) {
  gpio.Get("chip", chip);
  GetMicroseconds(gpio, "projector_pulse_us", wiring.projector_pulse, 1, 1'000'000);
  GetMicroseconds(gpio, "camera_pulse_us", wiring.camera_pulse, 1, 1'000'000);
  GetMicroseconds(gpio, "reset_pulse_us", wiring.reset_pulse, 1, 1'000'000);
  SLX_RETURN_IF_ERROR(ReadOutput(gpio, "camera_trigger", chip, wiring.camera_trigger));
  SLX_RETURN_IF_ERROR(ReadInput(gpio, "strobe", chip, wiring.strobe));
  SLX_RETURN_IF_ERROR(ReadInput(gpio, "emergency_stop", chip, wiring.emergency_stop));
  SLX_RETURN_IF_ERROR(ReadInput(gpio, "door", chip, wiring.door));
  return ReadInput(gpio, "start", chip, wiring.start);
}

Status ReadDisplay(TomlTable& table, DisplayWiring& display) {
  table.Get("device", display.device);
  table.Require("connector");
  table.Get("connector", display.connector);
  table.Get("width", display.width, 16, 8192);
  table.Get("height", display.height, 16, 8192);
  table.Get("refresh_hz", display.refresh_hz, 1, 1000);
  table.Get("latency_ms", display.latency_ms, 0, 1000);
  table.Get("gamma", display.gamma, 0.2, 5);
  return Status::Ok();
}

Status ReadProjector(TomlTable table, const std::string& chip, ProjectorWiring& projector, ProjectorLines& lines) {
  GetWord(table, "kind", projector.kind, {"memory", "display"});
  SLX_RETURN_IF_ERROR(ReadOutput(table, "enable", chip, lines.enable));
  if (projector.kind == ProjectorKind::kDisplay) return ReadDisplay(table, projector.display);
  for (const char* key : {"enable", "trigger", "sync"}) table.Require(key);
  SLX_RETURN_IF_ERROR(ReadOutput(table, "trigger", chip, lines.trigger));
  SLX_RETURN_IF_ERROR(ReadInput(table, "sync", chip, lines.sync));
  return ReadOutput(table, "reset", chip, lines.reset);
}

Status ReadCamera(TomlTable camera, CameraWiring& c) {
  GetWord(camera, "backend", c.backend, {"none", "v4l2", "libcamera"});
  camera.Get("device", c.device);
  camera.Get("driver", c.driver);
  camera.Get("card", c.card);
  camera.Get("bus", c.bus);
  camera.Get("format", c.format);
  camera.Get("width", c.width, 16, 16384);
  camera.Get("height", c.height, 16, 16384);
  GetWord(camera, "pace", c.pace, {"triggered", "free_running"});
  camera.Get("frame_rate_hz", c.frame_rate_hz, 0.1, 10000);
  camera.Get("buffers", c.buffers, 4, 32);
  GetWord(camera, "exposure_control", c.exposure_control, {"none", "exposure", "exposure_absolute"});
  camera.Get("exposure_unit_us", c.exposure_unit_us, 1e-3, 1e6);
  camera.Get("fixed_exposure_ms", c.fixed_exposure_ms, 0.001, 10000);
  GetWord(camera, "gain_control", c.gain_control, {"none", "gain", "analogue_gain"});
  camera.Get("gain_unit", c.gain_unit, 1e-3, 1e6);
  camera.Get("readout_ms", c.readout_ms, 0, 1000);
  GetWord(camera, "read_out", c.read_out, {"serial", "overlapped"});
  camera.Get("exposure_margin_ms", c.exposure_margin_ms, 0, 1000);
  camera.Get("min_frame_period_ms", c.min_frame_period_ms, 0, 10000);
  GetOptional(camera, "transfer_ms", c.transfer_ms, 0, 10000);
  camera.Get("reopen_tries", c.reopen_tries, 1, 100);
  camera.Get("gain_e_per_dn", c.gain_e_per_dn, 0.01, 1000);
  camera.Get("read_noise_dn", c.read_noise_dn, 0, 500);
  camera.Get("saturation_dn", c.saturation_dn, 16, 65535);
  if (c.backend == CameraBackend::kNone) return Status::Ok();
  if (c.device.empty() && c.driver.empty() && c.card.empty() && c.bus.empty())
    return Status::Usage(camera.Where("backend") +
                         ": say which camera with `device`, or with `driver`, `card` or `bus` for V4L2");
  if (c.exposure_control == ExposureControl::kNone && c.fixed_exposure_ms <= 0.0)
    return Status::Usage(camera.Where("exposure_control") +
                         ": a camera without an exposure control needs `fixed_exposure_ms`");
  return Status::Ok();
}

// No line may carry two signals.
Status CheckLinesDiffer(const RigConfig& config, const std::string& where) {
  std::vector<LineAddress> seen;
  auto claim = [&](const auto& wiring) {
    if (!wiring) return Status::Ok();
    if (std::find(seen.begin(), seen.end(), wiring->at) != seen.end())
      return Status::Usage(where + ": line " + wiring->at.ToString() + " carries two signals");
    seen.push_back(wiring->at);
    return Status::Ok();
  };
  for (const ProjectorLines& p : config.gpio.projectors) {
    SLX_RETURN_IF_ERROR(claim(p.enable));
    SLX_RETURN_IF_ERROR(claim(p.trigger));
    SLX_RETURN_IF_ERROR(claim(p.sync));
    SLX_RETURN_IF_ERROR(claim(p.reset));
  }
  SLX_RETURN_IF_ERROR(claim(config.gpio.camera_trigger));
  for (const auto* input : {&config.gpio.strobe, &config.gpio.emergency_stop, &config.gpio.door, &config.gpio.start})
    SLX_RETURN_IF_ERROR(claim(*input));
  return Status::Ok();
}

Status ReadDevices(TomlTable& root, RigConfig& config) {
  std::string chip;
  SLX_RETURN_IF_ERROR(ReadGpio(root.Table("gpio"), chip, config.gpio));
  SLX_RETURN_IF_ERROR(ReadCamera(root.Table("camera"), config.camera));
  for (TomlTable& table : root.Tables("projector"))
    SLX_RETURN_IF_ERROR(
        ReadProjector(table, chip, config.projectors.emplace_back(), config.gpio.projectors.emplace_back()));
  if (!config.projectors.empty() && static_cast<int>(config.projectors.size()) != config.plan.projectors)
    return Status::Usage(
        root.Where("projector") + ": " + std::to_string(config.projectors.size()) +
        " [[projector]] tables, but the plan has projectors = " + std::to_string(config.plan.projectors));
  return CheckLinesDiffer(config, root.Where("projector"));
}

Result<RigConfig> Read(TomlTable root) {
  RigConfig config;
  TomlTable capture = root.Table("capture"), plan = root.Table("plan");
  SLX_ASSIGN_OR_RETURN(config.store, ReadStoreConfig(root));
  capture.Get("settle_ms", config.settle_ms, 0, kLongestSettleMs);
  GetOptional(capture, "deadline_ms", config.deadline_ms, kShortestDeadlineMs, kLongestDeadlineMs);
  GetOptional(capture, "sync_delay_ms", config.sync_delay_ms, 0, 1000);
  capture.Get("max_on_time_s", config.max_on_time_s, 0.1, 3600);
  capture.Get("max_visit_s", config.max_visit_s, 1, 600);
  capture.Get("max_retries", config.max_retries, 0, 10);
  capture.Get("queue_frames", config.queue_frames, 1, 4096);
  capture.Get("calibration", config.calibration);
  capture.Get("realtime_priority", config.realtime_priority, 0, kHighestCapturePriority);
  SLX_RETURN_IF_ERROR(ReadPlan(plan, config.plan));
  const Status memory = ReadMemory(root.Table("memory"), config.memory);
  Result<KioskConfig> kiosk = ReadKiosk(root.Table("kiosk"));
  const Status devices = ReadDevices(root, config);
  SLX_RETURN_IF_ERROR(root.Finish());
  SLX_RETURN_IF_ERROR(devices);
  SLX_RETURN_IF_ERROR(memory);
  SLX_ASSIGN_OR_RETURN(config.kiosk, std::move(kiosk));
  SLX_RETURN_IF_ERROR(BuildPlan(config.plan).status().WithContext(plan.Where()));
  SLX_RETURN_IF_ERROR(LayOutMemories(config.plan, config.memory).status());
  return config;
}

}  // namespace

CameraTiming CameraTimingOf(const CameraWiring& camera) {
  return {camera.read_out, FromMilliseconds(camera.exposure_margin_ms), FromMilliseconds(camera.min_frame_period_ms)};
}

std::vector<std::optional<MemoryTiming>> MemoryTimingsOf(const RigConfig& config) {
  const MemoryTiming stepped{FromMilliseconds(config.sync_delay_ms.value_or(kSyncDelayMs)), std::nullopt};
  std::vector<std::optional<MemoryTiming>> timings(static_cast<size_t>(config.plan.projectors), stepped);
  for (size_t p = 0; p < config.projectors.size(); ++p) {
    if (config.projectors[p].kind == ProjectorKind::kDisplay) timings[p].reset();
    if (timings[p] && config.gpio.projectors[p].reset) timings[p]->reset = config.gpio.reset_pulse;
  }
  return timings;
}

Result<RigConfig> LoadRigConfig(const std::filesystem::path& file) {
  SLX_ASSIGN_OR_RETURN(auto root, TomlTable::ParseFile(file));
  return Read(std::move(root));
}

Result<RigConfig> ParseRigConfig(const std::string& text, const std::string& name) {
  SLX_ASSIGN_OR_RETURN(auto root, TomlTable::ParseText(text, name));
  return Read(std::move(root));
}

}  // namespace stratalux::rig
