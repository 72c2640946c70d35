// SPDX-License-Identifier: Apache-2.0
// Codes of column (or row) numbers: each plane is a pattern of stripes, and what the planes say at a site spells a word
// that stands for one column. Plane 0 is the word's most significant bit. One code has no stripes and no words but
// waves (micro_phase.h). How the codes compare: docs/math/geometry.md.
#pragma once

#include <optional>
#include <string>

#include "shared/base/result.h"

namespace stratalux {

inline constexpr int kMaxCodeBits = 16;

enum class ColumnCode {
  kGray,  // reflected Gray code: stripes of 2 columns in the finest plane, twice as wide in each coarser one
  // Every plane coarser than the base XORed with it (Gupta, Agrawal, Veeraraghavan & Narasimhan, IJCV 2013), so that no
  // stripe is wider than the base's and light from afar is the same under all planes. An edge of the base is one of
  // all.
  kXor2,        // base: the finest plane, stripes of 2 columns; the others have stripes of 1 and 2
  kXor4,        // base: the finest but one, stripes of 4 columns; the coarser ones have stripes of 2 to 4
  kMinStripe,   // a Gray code whose narrowest stripes are wide: 8 columns from 10 bits on (Goddyn & Gvozdjak 2003)
  kMicroPhase,  // sinusoids of several periods near that of the separation's (micro_phase.h)
};

// What the functions below tell of.
[[nodiscard]] constexpr bool IsOfStripes(ColumnCode code) { return code != ColumnCode::kMicroPhase; }

[[nodiscard]] const char* ToString(ColumnCode);
[[nodiscard]] Result<ColumnCode> ParseColumnCode(const std::string& text);

// The word of a column and back, one to one among the 2^bits columns that there are. `bits`: 1 .. kMaxCodeBits.
[[nodiscard]] unsigned WordOf(ColumnCode code, unsigned column, int bits);
[[nodiscard]] unsigned ColumnOf(ColumnCode code, unsigned word, int bits);

// The plane that coarser ones are XORed with; nullopt: none.
[[nodiscard]] std::optional<int> BasePlane(ColumnCode code, int bits);

// The narrowest stripe of any plane, columns; stripes at the first and the last column go on beyond them.
[[nodiscard]] int NarrowestStripe(ColumnCode code, int bits);

// Reflected Gray code of n and back.
[[nodiscard]] constexpr unsigned GrayFromBinary(unsigned n) { return n ^ (n >> 1); }
[[nodiscard]] constexpr unsigned BinaryFromGray(unsigned g) {
  for (unsigned shift = 1; shift < 32; shift <<= 1) g ^= g >> shift;
  return g;
}
// Bits needed to number `count` columns.
[[nodiscard]] int GrayBits(int count);

}  // namespace stratalux
