// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/photon_noise.h"

#include <algorithm>

namespace stratalux::fit {

PhotonNoise PhotonNoiseOf(const SrdBatch& batch, int64_t profile) {
  const double slope = batch.noise_slope[profile], floor = batch.noise_floor[profile];
  return slope > 0.0 ? PhotonNoise{1.0 / slope, floor / slope} : PhotonNoise{};
}

void NoiseLine::Add(float y, float variance) {
  sum_ += variance;
  ++added_;
  if (variance < least_) {
    least_ = variance;
    at_least_ = y;
  }
  if (variance >= most_) {
    most_ = variance;
    at_most_ = y;
  }
}

float NoiseLine::Slope() const {
  const double dy = double{at_most_} - std::max(0.0F, at_least_), dv = double{most_} - least_;
  return dy > 0.0 && dv > 0.0 ? static_cast<float>(dv / dy) : 0.0F;
}

double NoiseLine::Sum(int samples) const { return added_ > 0 ? sum_ * samples / added_ : 0.0; }

float NoiseLine::Floor() const {
  if (least_ > most_) return 0.0F;
  const float slope = Slope();
  if (slope == 0.0F) return 0.5F * (least_ + most_);
  return std::max(0.0F, least_ - slope * std::max(0.0F, at_least_));
}

}  // namespace stratalux::fit
