// SPDX-License-Identifier: Apache-2.0
// Which quads of the joint surface a projector lights (docs/math/geometry.md, "Lit").
#pragma once

#include <span>

#include "fitter/reconstruction/surface_map.h"
#include "fitter/separation/separation_map.h"
#include "fitter/structured_light/decoded_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

struct LitOptions {
  // An obstacle stands in the way, and light is missing, when it is so by so many standard deviations: where neither
  // the surface nor the light speaks against it, a quad is lit.
  double sigmas = 4.0;
  // Of the direct light that the quad's other lights let expect, less is a shadow. It has none but what noise and the
  // separation's error leave; a quad that is half in shadow has a half, and is an edge, a quad away from which the lit
  // ones lie.
  double min_share = 0.25;
  // A code further from where the surface lies speaks of another surface: scattering displaces it by less than one.
  double max_code_columns = 3.0;
  [[nodiscard]] Status Validate() const;
};

// By projector, on quads, 1 where its direct light falls.
// Lit is where the surface faces the projector within its picture; no other part of the surface stands in the way by
// more than both depths' error and the step from pixel to pixel of the projector; its light is not missing; most of its
// codes do not contradict; and of the eight neighbours none lies in shadow, or off the surface in the dark.
// `separation`: of each projector, its direct light and white; empty where none was captured: then light is missing
// where the white frame has none (the codes' kUnlit), and shadows of what is not on the surface show in contradicting
// codes alone. kUsage: sizes or numbers differ.
[[nodiscard]] Result<std::vector<Image<uint8_t>>> LitQuads(std::span<const DecodedMap> decoded,
                                                           std::span<const SeparationMap> separation,
                                                           const SurfaceMap& surface, const RigCalibration& rig,
                                                           const LitOptions& options = {});

enum class QuadLight : uint8_t { kUnknown = 0, kShadow = 1, kLit = 2 };
// 1 where a quad is lit and none of its eight neighbours lies in shadow; 0 at the picture's edge.
[[nodiscard]] Image<uint8_t> AwayFromShadow(const Image<QuadLight>& light);

}  // namespace stratalux::fit
