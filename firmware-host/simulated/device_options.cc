// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/device_options.h"

#include <algorithm>
#include <string>
#include <string_view>

#include "shared/config/toml_reader.h"
#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

constexpr std::array<std::string_view, 5> kCfas = {"mono", "rggb", "bggr", "grbg", "gbrg"};

template <size_t N>
Status GetArray(TomlTable& table, const std::string& key, std::array<double, N>& value, double limit) {
  if (!table.Has(key)) return Status::Ok();
  std::vector<double> read;
  table.Get(key, read, -limit, limit);
  if (read.size() != N)
    return Status::Usage(table.Where(key) + ": " + key + " takes " + std::to_string(N) + " numbers");
  std::copy(read.begin(), read.end(), value.begin());
  return Status::Ok();
}

Status ReadCamera(TomlTable t, CameraElectronics& camera) {
  if (t.Has("cfa")) {
    std::string cfa;
    t.Get("cfa", cfa);
    const auto* found = std::find(kCfas.begin(), kCfas.end(), cfa);
    if (found == kCfas.end())
      return Status::Usage(t.Where("cfa") + ": cfa '" + cfa + "' is unknown; allowed: mono, rggb, bggr, grbg, gbrg");
    camera.cfa = static_cast<Cfa>(found - kCfas.begin());
  }
  t.Get("bits", camera.bits, 10, 12);
  if (camera.bits == 11) return Status::Usage(t.Where("bits") + ": bits = 11; allowed: 10, 12");
  SLX_RETURN_IF_ERROR(GetArray(t, "distortion", camera.distortion, 2.0));
  t.Get("black_level_dn", camera.black_level_dn, 0.0, 1000.0);
  t.Get("gain_e_per_dn", camera.gain_e_per_dn, 0.01, 1000.0);
  t.Get("read_noise_dn", camera.read_noise_dn, 0.0, 500.0);
  t.Get("dark_current_e_per_s", camera.dark_current_e_per_s, 0.0, 1e6);
  t.Get("prnu", camera.prnu, 0.0, 0.5);
  t.Get("dsnu_dn", camera.dsnu_dn, 0.0, 500.0);
  t.Get("hot_pixels_per_mpx", camera.hot_pixels_per_mpx, 0.0, 1e5);
  t.Get("hot_dn_per_ms", camera.hot_dn_per_ms, 0.0, 1e4);
  t.Get("vignetting", camera.vignetting, 0.0, 3.0);
  t.Get("blur_px", camera.blur_px, 0.0, 5.0);
  t.Get("blooming", camera.blooming, 0.0, 1.0);
  t.Get("compression", camera.compression, 0.0, 0.5);
  std::string shutter = camera.shutter == Shutter::kGlobal ? "global" : "rolling";
  t.Get("shutter", shutter);
  if (shutter != "global" && shutter != "rolling")
    return Status::Usage(t.Where("shutter") + ": shutter '" + shutter + "' is unknown; allowed: global, rolling");
  camera.shutter = shutter == "global" ? Shutter::kGlobal : Shutter::kRolling;
  t.Get("line_time_us", camera.line_time_us, 0.0, 1000.0);
  return Status::Ok();
}

Status ReadProjector(TomlTable t, ProjectorOptics& projector) {
  SLX_RETURN_IF_ERROR(GetArray(t, "distortion", projector.distortion, 2.0));
  t.Get("blur_px", projector.blur_px, 0.0, 8.0);
  t.Get("focus_mm", projector.focus_mm, 0.0, 5000.0);
  t.Get("defocus_px_per_mm", projector.defocus_px_per_mm, 0.0, 1.0);
  SLX_RETURN_IF_ERROR(GetArray(t, "falloff", projector.falloff, 1.0));
  t.Get("gamma", projector.gamma, 0.2, 5.0);
  t.Get("black_level", projector.black_level, 0.0, 0.5);
  t.Get("flicker", projector.flicker, 0.0, 0.5);
  t.Get("lag_ms", projector.lag_ms, 0.0, 100.0);
  t.Get("drift_per_minute", projector.drift_per_minute, -0.5, 0.5);
  SLX_RETURN_IF_ERROR(GetArray(t, "turned_deg", projector.turned_deg, 5.0));
  return Status::Ok();
}

}  // namespace

MemoryTiming MemoryTimingOf(const RigTiming& timing) {
  return {FromMilliseconds(timing.memory_step_ms), FromMilliseconds(timing.memory_reset_ms)};
}

CameraTiming CameraTimingOf(const RigTiming& timing, const CameraTiming& configured) {
  return {timing.overlapped_readout ? ReadOut::kOverlapped : ReadOut::kSerial, configured.exposure_margin,
          FromMilliseconds(std::max(timing.min_frame_period_ms, timing.readout_ms))};
}

Result<DeviceOptions> ReadDevices(TomlTable& root) {
  DeviceOptions devices;
  SLX_RETURN_IF_ERROR(ReadCamera(root.Table("camera"), devices.camera));
  SLX_RETURN_IF_ERROR(ReadProjector(root.Table("projectors"), devices.projector));
  for (TomlTable& table : root.Tables("projector")) {
    devices.projectors.push_back(devices.projector);
    SLX_RETURN_IF_ERROR(ReadProjector(table, devices.projectors.back()));
  }
  TomlTable timing = root.Table("timing");
  timing.Get("sync_delay_ms", devices.timing.sync_delay_ms, 0.0, 1000.0);
  timing.Get("shutter_delay_ms", devices.timing.shutter_delay_ms, 0.0, 1000.0);
  timing.Get("readout_ms", devices.timing.readout_ms, 0.0, 1000.0);
  timing.Get("overlapped_readout", devices.timing.overlapped_readout);
  timing.Get("min_frame_period_ms", devices.timing.min_frame_period_ms, 0.0, 1000.0);
  timing.Get("memory_reset_ms", devices.timing.memory_reset_ms, 0.0, 10000.0);
  timing.Get("memory_step_ms", devices.timing.memory_step_ms, 0.0, 1000.0);
  timing.Get("jitter_us", devices.timing.jitter_us, 0.0, 1e5);
  timing.Get("frame_period_ms", devices.timing.frame_period_ms, 0.1, 1000.0);
  return devices;
}

}  // namespace stratalux::rig
