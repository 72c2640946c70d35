// SPDX-License-Identifier: Apache-2.0
// What the frames say of one site's Gray code: a probability a bit, and where the site may lie by all of them together
// (docs/math/geometry.md, eq. 5 and 6).
#pragma once

#include <array>
#include <cstdint>

namespace stratalux::fit {

inline constexpr int kMaxGrayBits = 16;

// Where the site lies, cells of the code; cells are as wide as the bits that were read make them.
struct CodeSpread {
  double mean = 0.0;
  double sigma = 0.0;   // of the cells near the most probable one, and of the place within a cell
  double astray = 0.0;  // probability that the site lies in none of them
};

class GrayWord {
 public:
  // The next finer bit; `one`: probability that the positive frame lit the site. At most kMaxGrayBits.
  void Push(double one) { one_[bits_++] = one; }

  [[nodiscard]] int bits() const { return bits_; }
  [[nodiscard]] unsigned MostProbable() const { return MostProbable(bits_); }
  // That the site's cell, of the code's leading `bits`, is this one.
  [[nodiscard]] double Probability(unsigned cell, int bits) const;
  [[nodiscard]] double Probability(unsigned cell) const { return Probability(cell, bits_); }
  // Of the cells within kNear of the most probable one. Two bits about which nothing is known (four cells) stay inside.
  [[nodiscard]] CodeSpread Spread() const;
  // As many leading bits as place the site to within one of their cells, but for the probability `astray`. A doubtful
  // bit on whose stripe edge the site lies does no harm: both values adjoin.
  [[nodiscard]] int TrustedBits(double astray) const;

  static constexpr int kNear = 4;

 private:
  [[nodiscard]] unsigned MostProbable(int bits) const;
  template <typename Visit>
  void ForEachNear(int bits, int reach, const Visit& visit) const;

  std::array<double, kMaxGrayBits> one_{};
  int bits_ = 0;
};

}  // namespace stratalux::fit
