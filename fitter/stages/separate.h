// SPDX-License-Identifier: Apache-2.0
// The separate stage: direct and global light of each projector.
#pragma once

#include <filesystem>
#include <vector>

#include "fitter/separation/separation_map.h"
#include "fitter/session/session_frames.h"
#include "shared/base/log.h"

namespace stratalux::fit {

inline constexpr int kSeparateVersion = 7;

// By projector. What its frames do not tell, because some are missing, is warned of and left unknown.
[[nodiscard]] Result<std::vector<SeparationMap>> SeparateFace(const SessionFrames& frames, Logger& logger);

// direct_<p>.exr, global_<p>.exr, separation_<p>.exr (variance, white, reason), separate.json.
Status SaveSeparation(const std::filesystem::path& folder, const std::vector<SeparationMap>& maps);
[[nodiscard]] Result<std::vector<SeparationMap>> LoadSeparation(const std::filesystem::path& folder);

}  // namespace stratalux::fit
