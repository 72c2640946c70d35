// SPDX-License-Identifier: Apache-2.0
// What of a profile's layers is estimable, with standard errors.
//
// Single layers are not: neighbours of nearly the same width trade their light at no cost in likelihood. What the data
// do hold are the layers' common changes. The Fisher information of the samples is therefore taken along seven of them,
//   w_l' = w_l (1 + a0 + a1 t_l + a2 t_l^2),  d_l' = d_l + b0 + b1 t_l,  sigma_l' = sigma_l (1 + c),  background' =
//   background + e,
// t_l = log sigma_l less its mean, and carried to the effective quantities by the delta method. A weak prior (one unit
// of a, b in mm, c) stands for the range that layers have; where it is all there is, so is the error.
#pragma once

#include <span>

#include "fitter/mixture/mixture_map.h"
#include "fitter/mixture/profile_fit.h"

namespace stratalux::fit {

struct Estimate {
  double value = 0.0;
  double standard_error = 0.0;
};

struct EffectiveParameters {
  Estimate total_weight;   // sum_l w_l: the albedo
  Estimate mean_depth_mm;  // sum_l w_l d_l / sum_l w_l; the centroid of a light's profile is s times it
  Estimate width_mm;       // sum_l w_l sigma_l / sum_l w_l
};

// Whether the lights' counts are photons, or only relative and to be scaled by the residuals' chi^2 (profiles from a
// file, whose noise nobody told).
enum class NoiseScale : uint8_t { kKnown, kFromResiduals };

// Costs about one EM sweep of the profile. All zero where the fit holds no light. Never NaN.
[[nodiscard]] EffectiveParameters EffectiveParametersOf(const ProfileFit& fit, std::span<const ProfileLight> lights,
                                                        NoiseScale noise);

// Of a profile of a fitted map; `lights` are the batches it was fitted to. All zero where it is not fitted.
[[nodiscard]] EffectiveParameters EffectiveParametersOf(const MixtureMap& map, int64_t profile,
                                                        std::span<const SrdBatch* const> lights,
                                                        const EmOptions& options);

}  // namespace stratalux::fit
