// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/probe_lattice.h"

#include <algorithm>
#include <numeric>
#include <span>

namespace stratalux::rig {

double MeanDn(const Image<uint16_t>& pixels) {
  // Chunks that 32 bits hold: half the time of 64-bit sums.
  constexpr size_t kChunk = 65536;
  uint64_t sum = 0;
  const std::span<const uint16_t> all = pixels.pixels();
  for (size_t i = 0; i < all.size(); i += kChunk) {
    const auto chunk = all.subspan(i, std::min(kChunk, all.size() - i));
    sum += std::accumulate(chunk.begin(), chunk.end(), uint32_t{0});
  }
  return pixels.empty() ? 0.0 : static_cast<double>(sum) / static_cast<double>(pixels.size());
}

ProbeLattice::ProbeLattice(int width, int height)
    : pitch_(std::max(1, width / kProbesPerRow)),
      columns_((width + pitch_ - 1) / pitch_),
      rows_((height + pitch_ - 1) / pitch_) {
  for (int j = 0; j < rows_; ++j) band_.insert(band_.end(), columns_, static_cast<uint8_t>(j * kBands / rows_));
}

Probes ProbeLattice::Sample(const Image<uint16_t>& pixels) const {
  Probes probes;
  probes.reserve(size());
  // Each row of probes stands one pixel further, each column one lower: along either axis all pixels are met, so that
  // no line of a comb falls between all probes.
  for (int j = 0; j < rows_; ++j)
    for (int i = 0; i < columns_; ++i)
      probes.push_back(pixels(std::min(i * pitch_ + j % pitch_, pixels.width() - 1),
                              std::min(j * pitch_ + i % pitch_, pixels.height() - 1)));
  return probes;
}

}  // namespace stratalux::rig
