// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/gray_word.h"

#include <algorithm>
#include <cmath>

#include "shared/pattern/pattern.h"

namespace stratalux::fit {

double GrayWord::Probability(unsigned cell, int bits) const {
  const unsigned gray = GrayFromBinary(cell);
  double probability = 1.0;
  for (int b = 0; b < bits; ++b) probability *= (gray >> (bits - 1 - b) & 1U) != 0 ? one_[b] : 1.0 - one_[b];
  return probability;
}

unsigned GrayWord::MostProbable(int bits) const {
  unsigned gray = 0;
  for (int b = 0; b < bits; ++b) gray = gray << 1 | (one_[b] > 0.5 ? 1U : 0U);
  return BinaryFromGray(gray);
}

template <typename Visit>
void GrayWord::ForEachNear(int bits, int reach, const Visit& visit) const {
  const int centre = static_cast<int>(MostProbable(bits));
  const int last = std::min(centre + reach, (1 << bits) - 1);
  for (int cell = std::max(centre - reach, 0); cell <= last; ++cell)
    visit(cell, Probability(static_cast<unsigned>(cell), bits));
}

CodeSpread GrayWord::Spread() const {
  double mass = 0.0, first = 0.0, second = 0.0;
  ForEachNear(bits_, kNear, [&](int cell, double probability) {
    mass += probability;
    first += probability * cell;
    second += probability * cell * cell;
  });
  const double mean = first / mass;
  const double within_cell = 1.0 / 12.0;  // uniform over one column
  return {mean, std::sqrt(std::max(0.0, second / mass - mean * mean) + within_cell), std::max(0.0, 1.0 - mass)};
}

int GrayWord::TrustedBits(double astray) const {
  for (int bits = bits_; bits > 0; --bits) {
    double mass = 0.0;
    ForEachNear(bits, 1, [&](int, double probability) { mass += probability; });
    if (mass >= 1.0 - astray) return bits;
  }
  return 0;
}

}  // namespace stratalux::fit
