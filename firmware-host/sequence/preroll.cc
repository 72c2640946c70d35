// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/preroll.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>

#include "firmware-host/sequence/probe_lattice.h"

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

OddMarker FindOddMarker(std::span<const Image<uint16_t>* const> frames, const std::vector<bool>& code,
                        const std::function<double(double dn)>& variance) {
  constexpr double kShare = 0.1, kDeviations = 5.0;
  OddMarker odd;
  if (frames.empty()) return odd;
  const ProbeLattice lattice(frames[0]->width(), frames[0]->height());
  for (const bool white : {true, false}) {
    std::vector<int> markers;
    std::vector<Probes> probes;
    for (size_t i = 0; i < frames.size(); ++i) {
      if (code[i] != white) continue;
      markers.push_back(static_cast<int>(i));
      probes.push_back(lattice.Sample(*frames[i]));
    }
    if (markers.size() < 3) continue;
    std::vector<std::array<int, ProbeLattice::kBands>> off(markers.size());
    std::array<int, ProbeLattice::kBands> all{};
    std::vector<double> levels(markers.size());
    for (size_t i = 0; i < lattice.size(); ++i) {
      for (size_t m = 0; m < markers.size(); ++m) levels[m] = probes[m][i];
      std::nth_element(levels.begin(), levels.begin() + levels.size() / 2, levels.end());
      const double median = levels[levels.size() / 2];
      const double limit = std::max(kShare * median, kDeviations * std::sqrt(variance(median)));
      const int band = lattice.BandOf(static_cast<int>(i));
      ++all[band];
      for (size_t m = 0; m < markers.size(); ++m) off[m][band] += std::abs(probes[m][i] - median) > limit;
    }
    for (size_t m = 0; m < markers.size(); ++m)
      for (int b = 0; b < ProbeLattice::kBands; ++b) {
        const double share = static_cast<double>(off[m][b]) / std::max(1, all[b]);
        if (share > odd.share) odd = {markers[m], share};
      }
  }
  return odd;
}

}  // namespace stratalux::rig
