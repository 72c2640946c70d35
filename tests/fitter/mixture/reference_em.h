// SPDX-License-Identifier: Apache-2.0
// EM of the scattering layers of ONE profile in plain double precision, written to be read beside model section 7
// (docs/math/em.md has the derivation): what the fast kernel is tested against.
#pragma once

#include <span>

#include "fitter/mixture/profile_fit.h"

namespace stratalux::fit {

// EM from `start`. Stops when the divergence falls by less than options.tolerance of itself a sweep, or after
// options.max_iterations sweeps.
[[nodiscard]] ProfileFit FitReference(std::span<const ProfileLight> lights, const LayerSet& start,
                                      const EmOptions& options);

// EM from a whole fit, which with options.prior.photons > 0 is also the centre of the prior (docs/math/em.md): then no
// sweep lowers the likelihood times the prior.
[[nodiscard]] ProfileFit RefineReference(std::span<const ProfileLight> lights, const ProfileFit& start,
                                         const EmOptions& options);
// What those sweeps lower: divergence and prior, over the data's sum. `centre`: the fit they started from.
[[nodiscard]] double PenalisedDivergence(std::span<const ProfileLight> lights, const ProfileFit& centre,
                                         const ProfileFit& fit, const EmOptions& options);

}  // namespace stratalux::fit
