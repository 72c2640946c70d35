// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/probe_lattice.h"

#include <algorithm>
#include <numeric>

namespace stratalux::rig {

namespace {
constexpr int kProbesPerRow = 240;
}

double MeanDn(const Image<uint16_t>& pixels) {
  const uint64_t sum = std::accumulate(pixels.pixels().begin(), pixels.pixels().end(), uint64_t{0});
  return pixels.empty() ? 0.0 : static_cast<double>(sum) / static_cast<double>(pixels.size());
}

ProbeLattice::ProbeLattice(int width, int height)
    : pitch_(std::max(1, width / kProbesPerRow)),
      columns_((width + pitch_ - 1) / pitch_),
      rows_((height + pitch_ - 1) / pitch_) {}

Probes ProbeLattice::Sample(const Image<uint16_t>& pixels) const {
  Probes probes;
  probes.reserve(size());
  for (int y = 0; y < pixels.height(); y += pitch_)
    for (int x = 0; x < pixels.width(); x += pitch_) probes.push_back(pixels(x, y));
  return probes;
}

}  // namespace stratalux::rig
