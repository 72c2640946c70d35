// SPDX-License-Identifier: Apache-2.0
// The Poisson-Gaussian noise of a profile: var(y) = (y + read_shift) / counts. A batch keeps it as two numbers a
// profile, the floor read_shift / counts and the slope 1 / counts.
#pragma once

#include <limits>

#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

struct PhotonNoise {
  double counts = 1.0;      // photons per unit of y
  double read_shift = 0.0;  // sigma_read^2 in units of y
};

// {1, 0} where the noise does not rise with the samples.
[[nodiscard]] PhotonNoise PhotonNoiseOf(const SrdBatch& batch, int64_t profile);

// Floor and slope of samples whose variances are known: the line through the quietest and the loudest of them. Slope 0,
// floor their mean, where the noise does not rise with the samples.
class NoiseLine {
 public:
  void Add(float y, float variance);
  [[nodiscard]] float Slope() const;
  [[nodiscard]] float Floor() const;  // 0 without samples
  // Of the variances of `samples` samples, as many as were added or some more.
  [[nodiscard]] double Sum(int samples) const;

 private:
  float least_ = std::numeric_limits<float>::infinity(), at_least_ = 0.0F;
  float most_ = -std::numeric_limits<float>::infinity(), at_most_ = 0.0F;
  double sum_ = 0.0;
  int added_ = 0;
};

}  // namespace stratalux::fit
