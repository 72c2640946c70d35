// SPDX-License-Identifier: Apache-2.0
// What the light of one projector looks like on a white card: few figures that stay the same from one morning to the
// next as long as lamp, lens, filters and card do.
#pragma once

#include <optional>

#include "shared/image/image.h"
#include "shared/image/pixel_format.h"

namespace stratalux::rig {

// L = white - black, sample by sample, in means of blocks of 16 x 16 samples (whole mosaic tiles). Lit: blocks whose L
// is at least half of that of the block which a twentieth of all exceed (no single bright spot says what is lit).
struct CardFigures {
  double dark_dn = 0.0;   // mean of the black frame, all samples
  double level_dn = 0.0;  // mean of L over the lit blocks
  double lit = 0.0;       // share of the blocks that are lit: where the card is, and how much of it
  double even = 0.0;      // mean L of the darkest tenth of the lit blocks, of that of their brightest tenth
  std::optional<double> red_green, blue_green;  // ratios of mean L of the colours, lit blocks; of a mosaic alone

  friend bool operator==(const CardFigures&, const CardFigures&) = default;
};

// Frames of one size, at least 64 x 64, else nullopt; nullopt, too, where white is nowhere brighter than black.
[[nodiscard]] std::optional<CardFigures> CardFiguresOf(const Image<uint16_t>& black, const Image<uint16_t>& white,
                                                       Cfa cfa);

}  // namespace stratalux::rig
