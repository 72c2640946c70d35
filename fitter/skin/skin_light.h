// SPDX-License-Identifier: Apache-2.0
// The light by which skin is told from hair and eyes: what went through a quad and came out again, of all projectors
// together (docs/math/skin-mask.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "fitter/reconstruction/surface_map.h"
#include "fitter/separation/separation_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

// kNotPositive: no more light came out than the separation's noise takes away, or the numbers are none.
enum class SkinReason : uint8_t { kMeasured = 0, kNoSurface = 1, kUnlit = 2, kNotPositive = 3 };
inline constexpr int kSkinReasons = 4;
[[nodiscard]] const char* ToString(SkinReason reason);

// On quads, W x H x C; NaN where the reason is not kMeasured.
struct SkinLight {
  Image<float> reflectance;  // global light over what a white target would reflect
  Image<float> share;        // global light over global and direct light
  Image<uint8_t> reason;     // W x H, SkinReason
  std::array<int64_t, kSkinReasons> counts{};
};

// With L_g and L_d of the projectors that light a quad (`lit`, by projector) and E what white would reflect there,
//   reflectance = sum L_g / sum E,   share = sum L_g / sum (L_g + L_d).        docs/math/skin-mask.md, (1) and (2)
// kUsage: not one separation and one map of lit quads for each projector, or sizes differ.
[[nodiscard]] Result<SkinLight> MeasureSkinLight(std::span<const SeparationMap> separation,
                                                 std::span<const Image<uint8_t>> lit, const SurfaceMap& surface,
                                                 const RigCalibration& rig, double exposure_ms);

}  // namespace stratalux::fit
