// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/code_word.h"

#include <algorithm>
#include <cmath>

namespace stratalux::fit {

double CodeWord::ProbabilityOf(unsigned word, int bits) const {
  double probability = 1.0;
  for (int b = 0; b < bits; ++b) probability *= (word >> (bits - 1 - b) & 1U) != 0 ? one_[b] : 1.0 - one_[b];
  return probability;
}

double CodeWord::Probability(unsigned cell, int bits) const {
  if (code_ == ColumnCode::kMinStripe) return ProbabilityOf(WordOf(code_, cell, bits), bits);
  const unsigned gray = GrayFromBinary(cell);
  if (base_ == kNoBase) return ProbabilityOf(gray, bits);
  const unsigned flipped = gray ^ (bits > base_ ? ~0U << (bits - base_) : ~0U);
  if (bits > base_) return ProbabilityOf((gray >> (bits - 1 - base_) & 1U) != 0 ? flipped : gray, bits);
  // Either half of a cell's columns has the base dark, the other half lit: the planes are independent given the base.
  return (1.0 - one_[base_]) * ProbabilityOf(gray, bits) + one_[base_] * ProbabilityOf(flipped, bits);
}

// Given the base, planes are independent, and of both values of the base the more probable one has the best cell.
unsigned CodeWord::MostProbable(int bits) const {
  unsigned word = 0;
  const bool flips = base_ != kNoBase && one_[base_] > 0.5;
  for (int b = 0; b < bits; ++b) word = word << 1 | ((one_[b] > 0.5) != (flips && b < base_) ? 1U : 0U);
  return code_ == ColumnCode::kMinStripe ? ColumnOf(code_, word, bits) : BinaryFromGray(word);
}

template <typename Visit>
void CodeWord::ForEachNear(int bits, int reach, const Visit& visit) const {
  const int centre = static_cast<int>(MostProbable(bits));
  const int last = std::min(centre + reach, (1 << bits) - 1);
  for (int cell = std::max(centre - reach, 0); cell <= last; ++cell)
    visit(cell, Probability(static_cast<unsigned>(cell), bits));
}

CodeSpread CodeWord::Spread() const {
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

int CodeWord::TrustedBits(double astray) const {
  const int fewest = code_ == ColumnCode::kMinStripe ? bits_ : 1;
  for (int bits = bits_; bits >= fewest; --bits) {
    double mass = 0.0;
    ForEachNear(bits, 1, [&](int, double probability) { mass += probability; });
    if (mass >= 1.0 - astray) return bits;
  }
  return 0;
}

}  // namespace stratalux::fit
