// SPDX-License-Identifier: Apache-2.0
// What the fitted layers of each pixel amount to, as maps: how much light comes back, from how deep, how far it spread.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <span>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/mixture_map.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// Widths of layers that part the light into three bands of equal strength, over the whole session and all colours.
// Bands are of width, not of the fitted depth: light that comes from deeper has spread wider, and widths are well
// measured, while the depths of all layers of a pixel share the error of the geometry, which is as large as they are.
struct DepthBands {
  double shallow_mm = 0.0, deep_mm = 0.0;  // sigma below the first: shallow; from the second on: deep
};

// All W x H x C as the MixtureMap; NaN where nothing was fitted. Depths also where they cannot be estimated.
struct LayerMaps {
  Image<float> total_weight;           // sum w: the albedo of the light that went through the skin
  Image<float> absorption;             // w_a = 1 - sum w [M 6]
  Image<float> mean_depth_mm;          // sum w d / sum w; NaN where no shift tells of depths
  Image<float> effective_width_mm;     // sqrt(sum w sigma^2 / sum w): one Gaussian with the same second moment
  Image<float> shallow, middle, deep;  // sum of w in each band
  DepthBands bands;
};
[[nodiscard]] LayerMaps SummariseLayers(const MixtureMap& map);

// Signal-to-noise ratio of each profile's samples, all lights (those that the map was fitted to) together: sum y /
// sqrt(sum variance); 0 where no light is usable.
[[nodiscard]] Image<float> SignalToNoise(const MixtureMap& map, std::span<const SrdBatch* const> lights);

// What is estimable of a profile's layers, or the standard errors of it, W x H x C; NaN where nothing was fitted.
struct EffectiveMaps {
  Image<float> total_weight, mean_depth_mm, effective_width_mm;
};
// Of a fit's folder, the files that WriteLayerMaps writes.
[[nodiscard]] Result<EffectiveMaps> LoadEffectiveMaps(const std::filesystem::path& folder, int channels);

// Standard errors by the noise of a profile's samples and white frames (fitter/mixture/standard_errors.h). For tied
// fits. `lights`, `options`: of the fit. Costs about one EM sweep in double precision a profile; `progress` receives
// profiles done.
[[nodiscard]] EffectiveMaps FindStandardErrors(const MixtureMap& map, std::span<const SrdBatch* const> lights,
                                               EmOptions options, const std::function<void(int64_t)>& progress);
// Noise is not all that a fit may be off by: what the surface reflects, how much light falls where, and the model
// itself err with each light, alike over many pixels. Fits that leave out one projector each, theta_p of n, tell how
// much: a fit of n - 1 lights whose errors are independent has the variance sum_p (theta_p - mean theta)^2 (delete-one
// jackknife). What of it noise does not explain, as its mean over the square of 2 `radius` + 1 profiles a side, of
// profiles that all of `left_out` have, weighted by 1 / noise^2, is added to `noise`: of total weights and widths
// relative to the value (values that the fits differ by more than do not count), of depths in mm. Errors that all
// lights share are not in it, and of a pixel that not all lights reach it is too large. `fit`: the values whose errors
// are told.
[[nodiscard]] EffectiveMaps WithDisagreement(const EffectiveMaps& noise, const EffectiveMaps& fit,
                                             std::span<const EffectiveMaps> left_out, int radius);
// How far around a pixel the lights' disagreement is taken for its own, mm.
inline constexpr double kDisagreementMm = 12.0;
// standard_errors.exr: total_weight.R, mean_depth_mm.R, effective_width_mm.R ..., and those of noise alone as
// noise_total_weight.R ...
Status WriteStandardErrors(const std::filesystem::path& folder, const EffectiveMaps& maps, const EffectiveMaps& noise);

inline constexpr const char* kEffectiveWidthFile = "effective_width_mm.exr";
// total_weight.exr, absorption.exr, mean_depth_mm.exr, effective_width_mm.exr, depth_bands.exr (docs/file-formats.md).
Status WriteLayerMaps(const std::filesystem::path& folder, const LayerMaps& maps);

}  // namespace stratalux::fit
