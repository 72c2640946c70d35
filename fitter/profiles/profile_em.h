// SPDX-License-Identifier: Apache-2.0
// EM of the layers of one set of measured profiles, in double precision (docs/math/em.md). Beyond FitMixture, which is
// told them, it finds what all layers share: tau of the angular gain and the directional weights, by the same
// likelihood. A set is one profile to it, fitted in a fraction of a second.
#pragma once

#include <span>

#include "fitter/mixture/profile_fit.h"

namespace stratalux::fit {

// What EM is free to change beyond the layers.
enum class SharedParameters : uint8_t { kFixed, kTau, kTauAndDirectional };

// What one standard deviation of a shared parameter's prior costs, in shares of the light: a tenth of what a wrong form
// of the directional weights costs on skin.
inline constexpr double kSharedPrior = 3e-5;

// EM from `start`, accelerated by SQUAREM, which never ends above the divergence of the plain sweeps it replaces. Stops
// when the divergence falls by less than options.tolerance of itself a sweep, or after options.max_iterations sweeps.
[[nodiscard]] ProfileFit RunProfileEm(std::span<const ProfileLight> lights, const LayerSet& start,
                                      const EmOptions& options, SharedParameters shared = SharedParameters::kFixed,
                                      double shared_prior = kSharedPrior);

}  // namespace stratalux::fit
