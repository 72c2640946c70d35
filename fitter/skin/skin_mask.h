// SPDX-License-Identifier: Apache-2.0
// Skin is what most of a face is: how far a quad's light is like that of the face's own majority
// (docs/math/skin-mask.md). Nothing is known of skin beforehand, so that dark skin is as much skin as light skin.
#pragma once

#include <array>
#include <cstdint>

#include "fitter/skin/skin_light.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::fit {

struct SkinOptions {
  // Skin is not all alike (lips, brown spots, grazing light), and what the geometry errs by comes on top: the scales of
  // its reflectance's logarithm and of its share are no narrower than these, however alike most of a face is.
  double least_log_scale = 0.5;
  double least_share_scale = 0.2;
  double freedom = 4.0;       // of Student's t: a quad far off is doubtful, never impossible
  double coupling = 2.0;      // nats that neighbours of one mind add
  int64_t least_quads = 100;  // measured ones; fewer have no majority
  bool by_reflectance = true, by_share = true;
  [[nodiscard]] Status Validate() const;
};

// Of the majority: the centre and scale of Student's t.
struct SkinTrait {
  double centre = 0.0, scale = 0.0;
};

struct SkinMask {
  Image<float> probability;                    // W x H; NaN where there is no surface
  Image<uint8_t> skin;                         // W x H; 1: more likely skin than not
  Image<uint8_t> reason;                       // W x H, SkinReason
  std::array<int64_t, kSkinReasons> counts{};  // of quads, by reason
  int64_t skin_quads = 0;
  // Whether light told. Else all of the surface counts as skin: no light was separated, or too few quads have any.
  bool told = false;
  int colour = 0;  // that told: in which most of the light went through
  SkinTrait log_reflectance{}, share{};

  [[nodiscard]] bool HasSurface(int i, int j) const {
    return reason(i, j) != static_cast<uint8_t>(SkinReason::kNoSurface);
  }
  [[nodiscard]] int64_t surface_quads() const;
  [[nodiscard]] int64_t left_out() const { return surface_quads() - skin_quads; }
};

// kUsage: options.
[[nodiscard]] Result<SkinMask> JudgeSkin(const SkinLight& light, const SkinOptions& options = {});
// All of the surface, where no light was separated.
[[nodiscard]] SkinMask AllSkin(ImageView<const uint8_t> surface);

}  // namespace stratalux::fit
