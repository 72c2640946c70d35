// SPDX-License-Identifier: Apache-2.0
// What the frames say of one site's code: a probability a bit, and where the site may lie by all of them together
// (docs/math/geometry.md, eq. 5 and 6).
#pragma once

#include <array>

#include "shared/pattern/column_code.h"

namespace stratalux::fit {

// Where the site lies, cells of the code; cells are as wide as the bits that were read make them.
struct CodeSpread {
  double mean = 0.0;
  double sigma = 0.0;   // of the cells near the most probable one, and of the place within a cell
  double astray = 0.0;  // probability that the site lies in none of them
};

class CodeWord {
 public:
  // Of a code of so many planes.
  explicit CodeWord(ColumnCode code = ColumnCode::kGray, int planes = kMaxCodeBits)
      : code_(code), base_(BasePlane(code, planes).value_or(kNoBase)) {
    if (base_ != kNoBase) one_[base_] = 0.5;
  }
  // The next plane; `one`: probability that its positive frame lit the site. At most the code's planes. Of a code of
  // minimum stripe width all must be pushed before anything is asked: no plane is coarser than another.
  void Push(double one) { one_[bits_++] = one; }
  // Of the plane that coarser ones are XORed with, where planes end before it; until then nothing is known of it.
  void SetBase(double one) { one_[base_] = one; }
  // What something beside the frames of the base says of it.
  void WeighBase(double one) {
    const double lit = one_[base_] * one, dark = (1.0 - one_[base_]) * (1.0 - one);
    one_[base_] = lit / (lit + dark);
  }
  [[nodiscard]] bool HasBase() const { return base_ != kNoBase; }
  [[nodiscard]] bool EndsBeforeBase() const { return base_ >= bits_; }
  // Precondition: HasBase().
  [[nodiscard]] int base() const { return base_; }

  [[nodiscard]] int bits() const { return bits_; }
  [[nodiscard]] unsigned MostProbable() const { return MostProbable(bits_); }
  // That the site's cell, of the code's leading `bits`, is this one.
  [[nodiscard]] double Probability(unsigned cell, int bits) const;
  [[nodiscard]] double Probability(unsigned cell) const { return Probability(cell, bits_); }
  // Of the cells within kNear of the most probable one. Two bits about which nothing is known (four cells) stay inside.
  [[nodiscard]] CodeSpread Spread() const;
  // As many leading bits as place the site to within one of their cells, but for the probability `astray`. A doubtful
  // bit on whose stripe edge the site lies does no harm: both values adjoin. All or none of a code of minimum stripe
  // width.
  [[nodiscard]] int TrustedBits(double astray) const;

  static constexpr int kNear = 4;

 private:
  static constexpr int kNoBase = -1;

  [[nodiscard]] unsigned MostProbable(int bits) const;
  // That the leading planes show these bits.
  [[nodiscard]] double ProbabilityOf(unsigned word, int bits) const;
  template <typename Visit>
  void ForEachNear(int bits, int reach, const Visit& visit) const;

  ColumnCode code_;
  int base_;
  std::array<double, kMaxCodeBits> one_{};  // by plane
  int bits_ = 0;
};

}  // namespace stratalux::fit
