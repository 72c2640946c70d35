// SPDX-License-Identifier: Apache-2.0
// What the held-out light's own sinusoids call direct, and what of a model's light they would.
//
// The separated direct image holds the surface's own light and what of the layers' the sinusoids' period still
// resolves (docs/math/evaluation.md). It is measured, and depends on no model. A model's share of it follows from its
// layers; so
//   total = direct image under the pattern + (the model's subsurface light - its share of the direct image)
// counts nothing twice, and is the same definition for every model.
#pragma once

#include "fitter/evaluation/heldout_view.h"
#include "fitter/mixture/mixture_map.h"
#include "fitter/reconstruction/surface_map.h"
#include "fitter/separation/separation_map.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

struct HeldOutLight {
  const RigCalibration& rig;  // linear (LinearRig)
  int projector = 0;
  double exposure_ms = 0.0;
  double separation_period = 8.0;  // px, of the sinusoids
};

[[nodiscard]] inline HeldOutLight SinusoidsOf(const HeldOutView& view) {
  return {view.separation_rig, view.projector, view.exposure_ms, view.separation_period};
}

// As a reflectance of the surface itself, W x H x C on quads; NaN where unknown, and where the projector does not reach
// it (`lit`). Noise of the direct image is shrunk towards the neighbours; a quad whose sinusoids tell nothing
// (saturated, negative) has their mean.
[[nodiscard]] Image<float> DirectReflectance(const HeldOutLight& light, const SurfaceMap& surface,
                                             ImageView<const uint8_t> lit, const SeparationMap& separation);
// The share of it of the model's layers beside a surface of `reflectance` (W x H x C), in the same unit; NaN where
// nothing was fitted.
[[nodiscard]] Image<float> DirectShare(const HeldOutLight& light, const SurfaceMap& surface, const MixtureMap& map,
                                       const Image<float>& reflectance, int pool);

}  // namespace stratalux::fit
