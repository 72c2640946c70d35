// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/simulation_flags.h"

#include <charconv>
#include <string_view>
#include <utility>

#include "firmware-host/simulated/light_cache.h"

namespace stratalux::rig {
namespace {

// The whole of `text` as a number that T can hold.
template <typename T>
bool ParseWhole(std::string_view text, T& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

Status ParseSize(const std::string& text, int& width, int& height) {
  const size_t x = text.find('x');
  if (x != std::string::npos && ParseWhole(std::string_view(text).substr(0, x), width) &&
      ParseWhole(std::string_view(text).substr(x + 1), height))
    return Status::Ok();
  return Status::Usage("--size '" + text + "': expected WIDTHxHEIGHT in pixels, such as 696x520");
}

}  // namespace

Status ApplySize(const SimulationFlags& flags, RigConfig& config) {
  return flags.size ? ParseSize(*flags.size, config.camera.width, config.camera.height) : Status::Ok();
}

Result<std::optional<SimulatedRigOptions>> SimulationFrom(const SimulationFlags& flags, int board_pose,
                                                          const RigConfig& config) {
  if (flags.scene.empty()) return std::optional<SimulatedRigOptions>();
  SimulatedRigOptions simulated;
  simulated.board_pose = board_pose;
  simulated.lens_covered = config.plan.kind == SessionKind::kDark;
  simulated.scene = flags.scene;
  simulated.seed = flags.seed;
  simulated.scattering = !flags.no_scattering;
  for (const std::string& text : flags.faults) {
    SLX_ASSIGN_OR_RETURN(const Fault fault, ParseFault(text).WithContext("--fault"));
    simulated.faults.script.push_back(fault);
  }
  simulated.faults.rate = flags.fault_rate;
  simulated.faults.seed = flags.fault_seed;
  simulated.noise = !flags.no_noise;
  simulated.free_running = config.plan.sync_mode == SyncMode::kFreeRunning;
  simulated.camera_width = config.camera.width;
  simulated.camera_height = config.camera.height;
  simulated.projector_width = config.plan.projector_width;
  simulated.projector_height = config.plan.projector_height;
  simulated.cache_folder = LightCache::FolderOfUser();
  simulated.control_pipe = flags.events;
  return std::optional(std::move(simulated));
}

std::string ComplaintOfChance(const std::string& text) {
  double rate = 0.0;
  return ParseWhole(text, rate) && rate >= 0.0 && rate <= 1.0 ? "" : "'" + text + "' is not a chance of 0 .. 1";
}

std::string ComplaintOfSeed(const std::string& text) {
  uint64_t seed = 0;
  return ParseWhole(text, seed) ? "" : "'" + text + "' is not a whole number of 0 .. 2^64-1";
}

}  // namespace stratalux::rig
