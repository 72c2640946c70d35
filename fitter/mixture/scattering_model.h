// SPDX-License-Identifier: Apache-2.0
// How light travels through the layers of a skin (model sections 6 and 7), whatever those layers are: what a fit
// assumes, its map keeps and every prediction from that map must assume, too.
#pragma once

#include <cstdint>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/shift_law.h"
#include "fitter/mixture/srd_samples.h"
#include "fitter/mixture/surface_reflection.h"

namespace stratalux::fit {

// kTied: a layer is displaced by its depth times the light's shift coefficient. kFree: each light's layers have
// displacements of their own, in mm, which stand where the depths do.
enum class FitMode : uint8_t { kTied, kFree };

struct ScatteringModel {
  FitMode mode = FitMode::kTied;
  ShiftLaw shift_law = ShiftLaw::kRefracted;
  double eta = 1.4;
  bool gain_model = true;          // false: every gain is 1
  double tau = 0.0;                // of the angular gain g (model section 7), one per session
  DirectionalWeights directional;  // of the layers; off unless set
  // Known: the surface term of a light is its reflectance. Unknown: every light's surface term is its own.
  SurfaceReflection reflection;
};

// s = (T(omega_i) - T(omega_o)) . e of a profile, mm of displacement per mm of depth; 1 in free mode.
[[nodiscard]] double ShiftCoefficient(const ScatteringModel& model, const SrdBatch& batch, int64_t profile);

// g of a light from that direction.
[[nodiscard]] double AngularGain(const ScatteringModel& model, double cos_in);

}  // namespace stratalux::fit
