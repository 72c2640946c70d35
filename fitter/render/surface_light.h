// SPDX-License-Identifier: Apache-2.0
// Light reflected by the surface itself: a reflectance times the irradiance of a light's pattern.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "fitter/mixture/mixture_map.h"
#include "fitter/render/lit_surface.h"

namespace stratalux::fit {

// Reflectance of the surface itself of every quad under `light`, W x H x C: of the fit's surface reflection, or, where
// the fit has none, the mean of its training lights'. NaN where nothing was fitted.
[[nodiscard]] Image<float> SurfaceReflectance(const MixtureMap& map, const SurfaceMap& surface,
                                              const ProjectorCalibration& light, int pool);

// What a surface of reflectance 1 returns under each of `lights`, patterns of the light that `lit` is lit by: W x H x C
// on quads, digital numbers above black, averaged over each pixel's box; 0 outside the surface and in shadow.
[[nodiscard]] std::vector<Image<float>> SurfaceIrradiance(const SurfaceMap& surface, const RigCalibration& rig,
                                                          const LitSurface& lit, std::span<const LitPyramid> lights);

// Reflectance times irradiance, pixel by pixel; 0 where the reflectance is not known.
[[nodiscard]] Image<float> ReflectedLight(const Image<float>& reflectance, const Image<float>& irradiance);

// A colour that was not fitted is unknown, not dark: NaN in each of `images`, where there is surface. How many quads of
// the surface lack one or more.
int64_t MarkUnfitted(const MixtureMap& map, const SurfaceMap& surface, int pool, std::span<Image<float>* const> images);

}  // namespace stratalux::fit
