// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/ablations.h"

#include <algorithm>
#include <numeric>

#include "shared/base/parallel.h"
#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

std::vector<SrdBatch*> AllBatches(SrdSet& srds) {
  std::vector<SrdBatch*> all;
  for (SrdBatch& b : srds.batches) all.push_back(&b);
  for (SrdBatch& b : srds.row_batches) all.push_back(&b);
  return all;
}

// Sample k of every profile becomes what sample order[k] was.
void Reorder(SrdBatch& batch, const std::vector<int>& order) {
  ParallelFor(batch.profiles(), 4096, [&](int64_t begin, int64_t end) {
    std::vector<float> before(batch.samples);
    for (int64_t i = begin; i < end; ++i)
      for (auto* values : {&batch.y, &batch.variance}) {
        float* samples = values->data() + i * batch.samples;
        std::copy(samples, samples + batch.samples, before.begin());
        for (int k = 0; k < batch.samples; ++k) samples[k] = before[order[k]];
      }
  });
}

}  // namespace

PermutedProjectors::PermutedProjectors(SrdSet& srds, int heldout) : srds_(srds) {
  for (int p = 0; p < static_cast<int>(srds.batches.size()); ++p)
    if (p != heldout) training_.push_back(p);
  Turn(1);
}

PermutedProjectors::~PermutedProjectors() { Turn(static_cast<int>(training_.size()) - 1); }

// Light k gets the directions of light k + by, around.
void PermutedProjectors::Turn(int by) {
  for (auto* batches : {&srds_.batches, &srds_.row_batches}) {
    if (batches->empty()) continue;
    for (int turn = 0; turn < by; ++turn)
      for (size_t k = 0; k + 1 < training_.size(); ++k) {
        SrdBatch &a = (*batches)[training_[k]], &b = (*batches)[training_[k + 1]];
        std::swap(a.slope_in, b.slope_in);
        std::swap(a.slope_in_across, b.slope_in_across);
        std::swap(a.cos_in, b.cos_in);
      }
  }
}

ShuffledCombFrames::ShuffledCombFrames(SrdSet& srds, uint64_t seed) : srds_(srds) {
  Random random(seed);
  for (SrdBatch* batch : AllBatches(srds)) {
    std::vector<int> order(batch->samples);
    std::iota(order.begin(), order.end(), 0);
    for (int k = batch->samples - 1; k > 0; --k)
      std::swap(order[k], order[random.Bits() % static_cast<uint64_t>(k + 1)]);
    Reorder(*batch, order);
    orders_.push_back(std::move(order));
  }
}

ShuffledCombFrames::~ShuffledCombFrames() {
  const auto batches = AllBatches(srds_);
  for (size_t b = 0; b < batches.size(); ++b) {
    std::vector<int> back(orders_[b].size());
    for (size_t k = 0; k < back.size(); ++k) back[orders_[b][k]] = static_cast<int>(k);
    Reorder(*batches[b], back);
  }
}

}  // namespace stratalux::fit
