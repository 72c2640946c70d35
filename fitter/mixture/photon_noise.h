// SPDX-License-Identifier: Apache-2.0
// The Poisson-Gaussian noise of a profile, read off its variances: var(y) = (y + read_shift) / counts.
#pragma once

#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

struct PhotonNoise {
  double counts = 1.0;      // photons per unit of y
  double read_shift = 0.0;  // sigma_read^2 in units of y
};

// {1, 0} where the variances do not rise with the samples.
[[nodiscard]] PhotonNoise PhotonNoiseOf(const SrdBatch& batch, int64_t profile);

}  // namespace stratalux::fit
