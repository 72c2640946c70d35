// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/row_memory.h"

#include <algorithm>

namespace stratalux::rig {
namespace {

constexpr size_t kFrames = 16;  // as many buffers as drivers give out
constexpr int kSamples = 32;

constexpr int kFewestBelow = kSamples / 4;  // samples that say something: those below the brightest

// FNV-1a over the samples; 0 when hardly any differs from the brightest, as where a white target saturates.
uint64_t NumberOf(const uint16_t* row, int width) {
  const int step = std::max(1, width / kSamples);
  uint16_t brightest = 0;
  for (int x = 0; x < width; x += step) brightest = std::max(brightest, row[x]);
  uint64_t number = 0xcbf29ce484222325ULL;
  int below = 0;
  for (int x = 0; x < width; x += step) {
    number = (number ^ row[x]) * 0x100000001b3ULL;
    below += row[x] < brightest;
  }
  return below >= std::min(kFewestBelow, width / 4) && below > 0 ? std::max<uint64_t>(number, 1) : 0;
}

}  // namespace

double RowMemory::ShareRepeated(const Image<uint16_t>& pixels) {
  std::vector<uint64_t> rows(static_cast<size_t>(pixels.height()));
  for (int y = 0; y < pixels.height(); ++y) rows[y] = NumberOf(pixels.row(y), pixels.width());
  size_t most = 0;
  for (const auto& earlier : frames_) {
    size_t same = 0;
    for (size_t y = 0; y < std::min(rows.size(), earlier.size()); ++y) same += rows[y] != 0 && rows[y] == earlier[y];
    most = std::max(most, same);
  }
  const double share = rows.empty() ? 0.0 : static_cast<double>(most) / static_cast<double>(rows.size());
  frames_.push_back(std::move(rows));
  if (frames_.size() > kFrames) frames_.pop_front();
  return share;
}

}  // namespace stratalux::rig
