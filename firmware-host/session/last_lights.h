// SPDX-License-Identifier: Apache-2.0
// The lights of the rig as it was last opened: what `stratalux-rig safe` goes by when the configuration cannot be read.
#pragma once

#include <filesystem>
#include <vector>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/session/state_file.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct RigLights {
  std::vector<OutputWiring> enables;    // ENABLE lines
  std::vector<DisplayWiring> displays;  // device and connector

  friend bool operator==(const RigLights&, const RigLights&) = default;
};
[[nodiscard]] RigLights LightsOf(const RigConfig& config);

// `folder`/lights.json (state_file.h), in StateFolder() for `safe` to find.
[[nodiscard]] Status KeepLights(const std::filesystem::path& folder, const RigLights& lights);
// Fails as ReadState does: whoever could put lines there could have any line driven.
[[nodiscard]] Result<RigLights> ReadLights(const std::filesystem::path& folder);

// Every light off: each is tried, whatever becomes of another; the first error.
[[nodiscard]] Status TakeLights(const RigLights& lights);

}  // namespace stratalux::rig
