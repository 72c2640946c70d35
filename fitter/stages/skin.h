// SPDX-License-Identifier: Apache-2.0
// The skin stage: which quads of the surface are skin, by the light of all projectors.
#pragma once

#include <filesystem>
#include <span>

#include "fitter/skin/skin_mask.h"
#include "fitter/stages/shape.h"
#include "fitter/stages/srd.h"

namespace stratalux::fit {

inline constexpr int kSkinVersion = 2;

// `rig`: shape.record, linear. `separation`: of each projector; empty where none was captured: then all of the surface
// counts as skin.
[[nodiscard]] Result<SkinMask> JudgeFaceSkin(const FaceShape& shape, std::span<const SeparationMap> separation,
                                             const RigCalibration& rig, double exposure_ms);
// For people: how much is skin, and by what.
[[nodiscard]] std::string Describe(const SkinMask& mask);

// By profile of a map of pixels of `pool` quads a side: 1 where less than half of the pixel's quads are skin.
[[nodiscard]] std::vector<uint8_t> ApartProfiles(const SkinMask& mask, int width, int height, int pool, int channels);

// What is no skin has no part in what all pixels share: sets SrdBatch::apart where less than half of a pixel's quads
// are skin. No pixel that some light reaches is skin: none is apart. kUsage: the mask is not of the SRDs' size.
Status SetApart(SrdSet& srds, const SkinMask& mask);

// skin.exr (probability, skin, reason), skin.json.
Status SaveSkin(const std::filesystem::path& folder, const SkinMask& mask);
[[nodiscard]] Result<SkinMask> LoadSkin(const std::filesystem::path& folder);

}  // namespace stratalux::fit
