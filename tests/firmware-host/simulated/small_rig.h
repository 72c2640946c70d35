// SPDX-License-Identifier: Apache-2.0
// An eighth of the default camera, a quarter of its projectors, without noise.
#pragma once

#include <string>

#include "firmware-host/simulated/simulated_rig.h"

namespace stratalux::rig {

inline SimulatedRigOptions SmallRig(const std::string& scene) {
  SimulatedRigOptions options;
  options.scene = scene;
  options.camera_width = 174;
  options.camera_height = 130;
  options.projector_width = 256;
  options.projector_height = 192;
  options.noise = false;
  return options;
}

}  // namespace stratalux::rig
