// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/gpio/gpio_wiring.h"

#include <algorithm>

namespace stratalux::rig {

std::string LineAddress::ToString() const { return !name.empty() ? name : chip + ":" + std::to_string(offset); }

bool GpioWiring::empty() const {
  const bool projector_lines = std::any_of(projectors.begin(), projectors.end(), [](const ProjectorLines& p) {
    return p.enable || p.trigger || p.sync || p.reset;
  });
  return !projector_lines && !camera_trigger && !strobe && !emergency_stop && !door && !start;
}

}  // namespace stratalux::rig
