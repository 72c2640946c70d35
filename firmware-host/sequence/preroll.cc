// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/preroll.h"

#include <algorithm>
#include <cstdlib>

namespace stratalux::rig {
namespace {

std::string Text(const std::vector<bool>& code) {
  std::string text;
  for (bool white : code) text += white ? '1' : '0';
  return text;
}

// Frames i show marker i - shift; what lies outside the code is unknown and fits anything.
bool MatchesShifted(const std::vector<bool>& read, const std::vector<bool>& code, int shift) {
  const int count = static_cast<int>(code.size());
  for (int i = std::max(0, shift); i < std::min(count, count + shift); ++i)
    if (read[i] != code[i - shift]) return false;
  return true;
}

}  // namespace

PrerollReading ReadPreroll(std::span<const double> mean_dn, const std::vector<bool>& code, double min_contrast_dn) {
  if (mean_dn.size() != code.size())
    return {false,
            "pre-roll: " + std::to_string(mean_dn.size()) + " frames for " + std::to_string(code.size()) + " markers"};
  if (code.empty()) return {true, ""};
  const auto [low, high] = std::minmax_element(mean_dn.begin(), mean_dn.end());
  if (*high - *low < min_contrast_dn)
    return {false, "pre-roll: white and dark markers differ by only " + std::to_string(*high - *low) +
                       " DN; is a lens covered, a projector dark or nobody in the rig?"};
  std::vector<bool> read;
  for (double mean : mean_dn) read.push_back(mean > (*low + *high) / 2);
  if (read == code) return {true, ""};
  // At least half of the code must speak for a shift, else it is no shift but disorder.
  const int count = static_cast<int>(code.size());
  for (int size = 1; size <= count / 2; ++size)
    for (int shift : {size, -size})
      if (MatchesShifted(read, code, shift))
        return {false, "pre-roll shifted by " + std::to_string(shift) + " frame(s): read " + Text(read) +
                           ", expected " + Text(code)};
  return {false, "pre-roll does not decode: read " + Text(read) + ", expected " + Text(code)};
}

}  // namespace stratalux::rig
