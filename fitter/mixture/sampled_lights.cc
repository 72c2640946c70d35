// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/sampled_lights.h"

namespace stratalux::fit {

SrdBatch SampledPixels(const SrdBatch& all, int channels, int every) {
  std::vector<int64_t> which;
  for (int64_t i = 0; i < all.profiles(); ++i)
    if (i / channels % every == 0 && !all.IsApart(i)) which.push_back(i);
  return ProfilesOf(all, which);
}

std::vector<SrdBatch> SampledPixels(std::span<const SrdBatch* const> lights, int channels, int every) {
  std::vector<SrdBatch> parts;
  for (const SrdBatch* light : lights) parts.push_back(SampledPixels(*light, channels, every));
  return parts;
}

}  // namespace stratalux::fit
