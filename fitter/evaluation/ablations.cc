// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/ablations.h"

#include <algorithm>
#include <numeric>

#include "shared/base/parallel.h"
#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

// Sample k of every profile becomes what sample order[k] was.
void Reorder(SrdBatch& batch, const std::vector<int>& order) {
  ParallelFor(batch.profiles(), 4096, [&](int64_t begin, int64_t end) {
    std::vector<float> before(batch.samples);
    for (int64_t i = begin; i < end; ++i) {
      if (batch.valid[i] == 0) continue;
      const std::span<float> samples = batch.Samples(i);
      std::ranges::copy(samples, before.begin());
      for (int k = 0; k < batch.samples; ++k) samples[k] = before[order[k]];
    }
  });
}

}  // namespace

SrdSet WithPermutedProjectors(SrdSet srds, int heldout) {
  std::vector<int> training;
  for (int p = 0; p < static_cast<int>(srds.batches.size()); ++p)
    if (p != heldout) training.push_back(p);
  for (auto* batches : {&srds.batches, &srds.row_batches}) {
    if (batches->empty()) continue;
    std::vector<SrdBatch*> lit;
    for (int64_t i = 0; i < batches->front().profiles(); ++i) {
      // Only among the lights that reach it: directions of another would take the light away.
      lit.clear();
      for (const int p : training)
        if ((*batches)[p].valid[i] != 0) lit.push_back(&(*batches)[p]);
      for (size_t k = 0; k + 1 < lit.size(); ++k)
        for (auto of : {&SrdBatch::slope_in, &SrdBatch::slope_in_across, &SrdBatch::cos_in})
          std::swap((lit[k]->*of)[i], (lit[k + 1]->*of)[i]);
    }
  }
  return srds;
}

SrdSet WithShuffledCombFrames(SrdSet srds, uint64_t seed) {
  Random random(seed);
  for (auto* batches : {&srds.batches, &srds.row_batches})
    for (SrdBatch& batch : *batches) {
      std::vector<int> order(batch.samples);
      std::iota(order.begin(), order.end(), 0);
      for (int k = batch.samples - 1; k > 0; --k)
        std::swap(order[k], order[random.Bits() % static_cast<uint64_t>(k + 1)]);
      Reorder(batch, order);
    }
  return srds;
}

}  // namespace stratalux::fit
