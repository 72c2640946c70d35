// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/card_figures.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "firmware-host/sequence/probe_lattice.h"

namespace stratalux::rig {
namespace {

constexpr int kBlock = 16, kSmallest = 64;

struct Block {
  double light = 0.0;                  // mean L
  std::array<double, 3> colours = {};  // sums of L
  std::array<int, 3> samples = {};
};

Block BlockAt(const Image<uint16_t>& black, const Image<uint16_t>& white, Cfa cfa, int left, int top) {
  Block block;
  for (int y = top; y < top + kBlock; ++y)
    for (int x = left; x < left + kBlock; ++x) {
      const auto colour = static_cast<size_t>(CfaColour(cfa, x, y));
      const double light = static_cast<double>(white(x, y)) - black(x, y);
      block.light += light;
      block.colours[colour] += light;
      ++block.samples[colour];
    }
  block.light /= kBlock * kBlock;
  return block;
}

double MeanLight(const std::vector<Block>& blocks, size_t from, size_t to) {
  double sum = 0.0;
  for (size_t i = from; i < to; ++i) sum += blocks[i].light;
  return sum / static_cast<double>(to - from);
}

// Of `colour` over green.
std::optional<double> Ratio(const std::vector<Block>& blocks, size_t colour) {
  std::array<double, 3> sums = {};
  std::array<double, 3> samples = {};
  for (const Block& block : blocks)
    for (size_t c = 0; c < 3; ++c) {
      sums[c] += block.colours[c];
      samples[c] += block.samples[c];
    }
  if (samples[colour] <= 0.0 || samples[1] <= 0.0 || sums[1] <= 0.0) return std::nullopt;
  return sums[colour] / samples[colour] / (sums[1] / samples[1]);
}

}  // namespace

std::optional<CardFigures> CardFiguresOf(const Image<uint16_t>& black, const Image<uint16_t>& white, Cfa cfa) {
  if (white.width() < kSmallest || white.height() < kSmallest) return std::nullopt;
  if (black.width() != white.width() || black.height() != white.height()) return std::nullopt;
  std::vector<Block> blocks;
  for (int top = 0; top + kBlock <= white.height(); top += kBlock)
    for (int left = 0; left + kBlock <= white.width(); left += kBlock)
      blocks.push_back(BlockAt(black, white, cfa, left, top));
  std::sort(blocks.begin(), blocks.end(), [](const Block& a, const Block& b) { return a.light < b.light; });
  const size_t all = blocks.size();
  const double bright = blocks[all - 1 - all / 20].light;
  if (bright <= 0.0) return std::nullopt;
  const auto first_lit =
      std::find_if(blocks.begin(), blocks.end(), [bright](const Block& block) { return block.light >= 0.5 * bright; });
  blocks.erase(blocks.begin(), first_lit);
  const size_t tenth = std::max<size_t>(1, blocks.size() / 10);
  CardFigures figures;
  figures.dark_dn = MeanDn(black);
  figures.level_dn = MeanLight(blocks, 0, blocks.size());
  figures.lit = static_cast<double>(blocks.size()) / static_cast<double>(all);
  figures.even = MeanLight(blocks, 0, tenth) / MeanLight(blocks, blocks.size() - tenth, blocks.size());
  if (cfa != Cfa::kMono) {
    figures.red_green = Ratio(blocks, 0);
    figures.blue_green = Ratio(blocks, 2);
  }
  return figures;
}

}  // namespace stratalux::rig
