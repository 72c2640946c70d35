// SPDX-License-Identifier: Apache-2.0
// The lights of the rig as it was last opened: what `stratalux-rig safe` goes by when the configuration cannot be read.
#pragma once

#include <filesystem>
#include <vector>

#include "firmware-host/config/rig_config.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct RigLights {
  std::vector<OutputWiring> enables;    // ENABLE lines
  std::vector<DisplayWiring> displays;  // device and connector

  friend bool operator==(const RigLights&, const RigLights&) = default;
};
[[nodiscard]] RigLights LightsOf(const RigConfig& config);

// $STATE_DIRECTORY (systemd's), else /var/lib/stratalux.
[[nodiscard]] std::filesystem::path StateFolder();
// Replaces `folder`/lights.json, whole or not at all; readable and writable for its owner alone.
[[nodiscard]] Status KeepLights(const std::filesystem::path& folder, const RigLights& lights);
// kNotFound: none was kept. kFailed: another account than this one or root owns it, others may write to it, it is no
// plain file, or it does not say what KeepLights writes: whoever could put lines there could have any line driven.
[[nodiscard]] Result<RigLights> ReadLights(const std::filesystem::path& folder);

// Every light off: each is tried, whatever becomes of another; the first error.
[[nodiscard]] Status TakeLights(const RigLights& lights);

}  // namespace stratalux::rig
