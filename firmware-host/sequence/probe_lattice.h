// SPDX-License-Identifier: Apache-2.0
// ProbeLattice: single camera pixels spread over the frame, by which the sequencer recognises pictures at little cost.
#pragma once

#include <cstdint>
#include <vector>

#include "shared/image/image.h"

namespace stratalux::rig {

// Probes of one frame, raw digital numbers, in the order of the lattice's rows.
using Probes = std::vector<uint16_t>;

// Of all pixels.
[[nodiscard]] double MeanDn(const Image<uint16_t>& pixels);

class ProbeLattice {
 public:
  // Bands of rows that are judged apart, so that a frame that is wrong in some rows only is seen.
  static constexpr int kBands = 8;

  ProbeLattice() = default;
  // Of a frame that is wide enough; of a smaller one all pixels, each as wide as several columns of the projector.
  static constexpr int kProbesPerRow = 160;
  // About so many probes a row.
  ProbeLattice(int width, int height);

  [[nodiscard]] Probes Sample(const Image<uint16_t>& pixels) const;
  [[nodiscard]] size_t size() const { return static_cast<size_t>(columns_) * rows_; }
  [[nodiscard]] int pitch() const { return pitch_; }  // camera pixels from probe to probe
  // Probes a row: probe i + 1 stands beside i, probe i + columns() below it.
  [[nodiscard]] int columns() const { return columns_; }
  [[nodiscard]] int BandOf(int probe) const { return band_[probe]; }

 private:
  int pitch_ = 1;  // camera pixels from probe to probe
  int columns_ = 0, rows_ = 0;
  std::vector<uint8_t> band_;  // of each probe
};

}  // namespace stratalux::rig
