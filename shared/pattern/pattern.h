// SPDX-License-Identifier: Apache-2.0
// Patterns that a projector shows. The controller projects them, the fitter decodes them: both ask this one
// description. Intensities are linear light, 0 = projector black, 1 = white.
#pragma once

#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/image/image.h"
#include "shared/pattern/column_code.h"

namespace stratalux {

enum class PatternKind {
  kBlack,
  kWhite,
  kGray,          // one bit of the code of the column (or row) number
  kCheckerboard,  // squares of `period` / 2 pixels, moved by (shift % shifts, shift / shifts) * period / shifts
  kSinusoid,      // 0.5 + 0.5 cos(2 pi (c + 0.5) / period - 2 pi shift / shifts)
  kComb,          // lines `width` wide every `period` pixels, the first one at offset `shift`
  kSpots,         // discs of radius `width` on a square lattice of pitch `period`
  kGrey,          // one grey level `shift` of `shifts` everywhere; what light it gives is the projector's response
};

enum class PatternAxis { kColumns, kRows };

struct Pattern {
  PatternKind kind = PatternKind::kBlack;
  PatternAxis axis = PatternAxis::kColumns;
  int bit = 0;           // kGray: 0 = most significant (of a reflected Gray code the coarsest)
  int bits = 0;          // kGray: number of bits of the code
  bool inverse = false;  // kGray
  ColumnCode code = ColumnCode::kGray;
  int period = 0;  // px; of the waves of kMicroPhase, the one that theirs lie around
  int width = 0;   // px
  int shift = 0;
  int shifts = 1;

  friend bool operator==(const Pattern&, const Pattern&) = default;

  // True when the intensity depends on the column alone or on the row alone (white, black and grey: on neither).
  [[nodiscard]] bool IsOneDimensional() const {
    return kind != PatternKind::kCheckerboard && kind != PatternKind::kSpots;
  }
  // Intensity of projector pixel (column, row).
  [[nodiscard]] float Intensity(int column, int row) const;
  // The `count` intensities along the pattern's axis (columns for white and black). Precondition: IsOneDimensional().
  [[nodiscard]] std::vector<float> Profile(int count) const;
  [[nodiscard]] Image<float> Render(int width_px, int height_px) const;
  // True when there are levels between 0 and 1, which a projector needs eight bit planes for.
  [[nodiscard]] bool HasLevels() const {
    return kind == PatternKind::kSinusoid || kind == PatternKind::kGrey ||
           (kind == PatternKind::kGray && !IsOfStripes(code));
  }
  // Text such as "gray columns bit=3/10 inverse" or "gray rows bit=0/10 code=xor-4", as stored in each frame's proof
  // row; Parse reads it back.
  [[nodiscard]] std::string ToString() const;
  [[nodiscard]] static Result<Pattern> Parse(const std::string& text);
  // Refuses what no projector of this size can show (period 0, shift out of range, too many bits, ...).
  [[nodiscard]] Status Validate(int projector_width, int projector_height) const;
};

}  // namespace stratalux
