// SPDX-License-Identifier: Apache-2.0
// The separate stage: direct and global light of each projector.
#pragma once

#include <filesystem>
#include <vector>

#include "fitter/separation/separation_map.h"
#include "fitter/session/session_frames.h"

namespace stratalux::fit {

inline constexpr int kSeparateVersion = 7;

// By projector.
[[nodiscard]] Result<std::vector<SeparationMap>> SeparateFace(const SessionFrames& frames);

// direct_<p>.exr, global_<p>.exr, separation_<p>.exr (variance, white, reason), separate.json.
Status SaveSeparation(const std::filesystem::path& folder, const std::vector<SeparationMap>& maps);
[[nodiscard]] Result<std::vector<SeparationMap>> LoadSeparation(const std::filesystem::path& folder);

}  // namespace stratalux::fit
