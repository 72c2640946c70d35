// SPDX-License-Identifier: Apache-2.0
// A station that captures in a blink: an opaque plane before four small projectors.
#pragma once

#include <filesystem>

#include "firmware-host/session/capture_station.h"

namespace stratalux::rig {

// `config` with a simulated rig of its sizes, without light transport in the skin.
inline void Simulate(StationOptions& options, const std::string& scene) {
  const RigConfig& config = options.config;
  SimulatedRigOptions& simulated = options.simulated.emplace();
  simulated.scene = scene;
  simulated.scattering = false;
  simulated.camera_width = config.camera.width;
  simulated.camera_height = config.camera.height;
  simulated.projector_width = config.plan.projector_width;
  simulated.projector_height = config.plan.projector_height;
}

// Its store lies in `folder`.
inline StationOptions SmallStation(const std::filesystem::path& folder) {
  StationOptions options;
  RigConfig& config = options.config;
  config.store.folder = (folder / "store").string();
  config.camera.width = 88;
  config.camera.height = 66;
  config.plan.projectors = 4;
  config.plan.projector_width = 128;
  config.plan.projector_height = 96;
  config.plan.comb_period = 32;
  config.plan.spot_pitch = 32;
  config.plan.spot_radius = 2;
  Simulate(options, "plane");
  return options;
}

}  // namespace stratalux::rig
