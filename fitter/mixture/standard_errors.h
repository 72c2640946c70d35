// SPDX-License-Identifier: Apache-2.0
// What of a profile's layers is estimable, with standard errors.
//
// Single layers are not: neighbours of nearly the same width trade their light at no cost in likelihood. What the data
// do hold are the layers' common changes. The Fisher information of the samples is therefore taken along seven of them,
//   w_l' = w_l (1 + a0 + a1 t_l + a2 t_l^2),  d_l' = d_l + b0 + b1 t_l,  sigma_l' = sigma_l (1 + c),  background' =
//   background + e,
// t_l = log sigma_l less its mean, and carried to the effective quantities by the delta method. The prior that the fit
// was held by adds the curvature of its own cost, and the total weight is scaled to the white frames as the fit scales
// it (docs/math/em.md, "What is estimable"). A weak prior (one unit of a, b in mm, c) stands for the range that layers
// have; where it is all there is, so is the error.
//
// The standard errors are of noise alone: a value +- kInterval95 of them holds in 95 of 100 captures of the same skin
// what EM would find without noise, not what a model of another form would.
#pragma once

#include <span>

#include "fitter/mixture/mixture_map.h"
#include "fitter/mixture/profile_fit.h"

namespace stratalux::fit {

// Standard errors on either side of a value that a normal distribution leaves 5 % beyond.
inline constexpr double kInterval95 = 1.959964;

struct Estimate {
  double value = 0.0;
  double standard_error = 0.0;
};

struct EffectiveParameters {
  Estimate total_weight;        // sum_l w_l: the albedo
  Estimate mean_depth_mm;       // sum_l w_l d_l / sum_l w_l; the centroid of a light's profile is s times it
  Estimate effective_width_mm;  // sqrt(sum_l w_l sigma_l^2 / sum_l w_l): one Gaussian with the same second moment
};

// Whether the lights' counts are photons, or only relative and to be scaled by the residuals' chi^2 (profiles from a
// file, whose noise nobody told).
enum class NoiseScale : uint8_t { kKnown, kFromResiduals };

// What is known of a profile beside its samples.
struct KnownBeside {
  LayerPrior prior;       // that the fit was held by, centred near it
  bool has_floor = true;  // false: the model has none, and no light is traded with it
};

// Costs about one EM sweep of the profile. All zero where the fit holds no light. Never NaN.
[[nodiscard]] EffectiveParameters EffectiveParametersOf(const ProfileFit& fit, std::span<const ProfileLight> lights,
                                                        NoiseScale noise, const KnownBeside& beside = {});

// Of a profile of a fitted map, by the map's own prior; `lights` are the batches it was fitted to. All zero where it is
// not fitted.
[[nodiscard]] EffectiveParameters EffectiveParametersOf(const MixtureMap& map, int64_t profile,
                                                        std::span<const SrdBatch* const> lights,
                                                        const EmOptions& options);

}  // namespace stratalux::fit
