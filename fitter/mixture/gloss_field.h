// SPDX-License-Identifier: Apache-2.0
// How glossy skin is, place by place: dry over most of a face, while sebum makes forehead, nose and chin mirror more
// (Weyrich et al. 2006). Smooth, and told by the lights of many pixels together (docs/math/surface.md).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace stratalux::fit {

// The map whose profiles are asked about. A spacing of 0: unknown.
struct ProfileGrid {
  int width = 0, height = 0, channels = 1;
  double spacing_mm = 0.0;  // between neighbouring pixels, on the skin
};

// 0 where skin is dry, more where it is glossier; linear between nodes of a square grid over the map.
struct GlossField {
  int width = 0, channels = 1;  // of the map
  int cell_px = 1, columns = 0;
  std::vector<double> nodes;  // row by row; empty: 0 everywhere

  // Of a profile of the map.
  [[nodiscard]] double At(int64_t profile) const;
  // Whether these are the nodes of such a map, as read from a file; none are those of any.
  [[nodiscard]] bool IsOf(const ProfileGrid& map) const;
};

// A field of zeros, its nodes kGlossCellMm apart; empty where the spacing is unknown.
inline constexpr double kGlossCellMm = 12.0;
[[nodiscard]] GlossField FlatGloss(const ProfileGrid& grid);

// What a profile says of the gloss where it lies: it costs (residual - gloss effect)^2 / 2, summed over its lights, in
// standard deviations; `along` the sum of their products, `square` that of effect^2.
struct GlossWitness {
  int64_t profile = 0;
  double along = 0.0, square = 0.0;
};

// The most likely field that is nowhere below 0: sebum adds to what dry skin mirrors. Nodes are exponential, since
// most of a face is dry, their differences hold neighbours together, and the profiles of a cell, which err alike, count
// as few however many they are. `field`: of FlatGloss; its nodes are taken anew.
void SolveGloss(std::span<const GlossWitness> witnesses, GlossField& field);

}  // namespace stratalux::fit
