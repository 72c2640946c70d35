// SPDX-License-Identifier: Apache-2.0
// One pixel in so many of every light: what a session's few shared numbers are chosen on.
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

// The same profiles of each light.
class SampledBatches {
 public:
  SampledBatches(std::span<const SrdBatch* const> lights, std::span<const int64_t> which) {
    for (const SrdBatch* light : lights) parts_.push_back(ProfilesOf(*light, which));
    for (const SrdBatch& part : parts_) batches_.push_back(&part);
  }
  [[nodiscard]] std::span<const SrdBatch* const> batches() const { return batches_; }

 private:
  std::vector<SrdBatch> parts_;
  std::vector<const SrdBatch*> batches_;
};

// Every so many pixels of a batch, all `channels` profiles of each, in their order, but for those that stand apart.
[[nodiscard]] SrdBatch SampledPixels(const SrdBatch& all, int channels, int every);

[[nodiscard]] std::vector<SrdBatch> SampledPixels(std::span<const SrdBatch* const> lights, int channels, int every);

}  // namespace stratalux::fit
