// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/lit_blocks.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace stratalux::rig {
namespace {

constexpr double kLitShare = 0.1;     // of the brightest tenth's signal
constexpr double kLeastSigmas = 6.0;  // of a block's mean, to be light at all
constexpr size_t kLeastBlocks = 16;

std::vector<LitBlock> BlocksOf(const PreScan& scan) {
  std::vector<LitBlock> blocks;
  for (int y = 0; y + kLitBlock <= scan.white.height(); y += kLitBlock)
    for (int x = 0; x + kLitBlock <= scan.white.width(); x += kLitBlock) {
      double sum = 0.0;
      for (int j = 0; j < kLitBlock; ++j)
        for (int i = 0; i < kLitBlock; ++i) sum += double(scan.white(x + i, y + j)) - double(scan.black(x + i, y + j));
      blocks.push_back({x, y, static_cast<float>(sum * kQuadSamples / (kLitBlock * kLitBlock))});
    }
  return blocks;
}

}  // namespace

std::vector<LitBlock> LitBlocks(const PreScan& scan, double read_noise_dn) {
  const double noise = kQuadSamples * read_noise_dn * std::sqrt(2.0 / (kLitBlock * kLitBlock));
  std::vector<LitBlock> blocks = BlocksOf(scan);
  std::erase_if(blocks, [&](const LitBlock& block) { return block.signal <= kLeastSigmas * noise; });
  if (blocks.size() < kLeastBlocks) return {};
  std::vector<float> signals;
  for (const LitBlock& block : blocks) signals.push_back(block.signal);
  const auto brightest = signals.begin() + static_cast<std::ptrdiff_t>(0.9 * static_cast<double>(signals.size() - 1));
  std::nth_element(signals.begin(), brightest, signals.end());
  const double least = kLitShare * *brightest;
  std::erase_if(blocks, [&](const LitBlock& block) { return block.signal < least; });
  return blocks;
}

}  // namespace stratalux::rig
