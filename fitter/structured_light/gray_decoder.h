// SPDX-License-Identifier: Apache-2.0
// Decoding of Gray codes, refined by the phase of shifted sinusoids where there are any (model section 3,
// docs/math/geometry.md). A doubtful bit costs certainty, not the site: the sigma holds what it leaves open.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "fitter/structured_light/code_word.h"
#include "fitter/structured_light/decoded_map.h"
#include "fitter/structured_light/sensor_noise.h"
#include "shared/base/result.h"

namespace stratalux::fit {

using RawView = ImageView<const uint16_t>;

// Of two frames one may be empty: the other is decided against white and black. Where both are, the bit tells nothing.
struct CodedBit {
  RawView positive{};
  RawView inverse{};
  [[nodiscard]] bool IsWhole() const { return !positive.empty() && !inverse.empty(); }
  [[nodiscard]] bool IsLost() const { return positive.empty() && inverse.empty(); }
};

// One axis of one projector; without bits and shifts it was not captured.
struct AxisCode {
  int count = 0;                  // columns (or rows) of the projector
  std::vector<CodedBit> bits{};   // most significant first
  std::vector<RawView> shifts{};  // sinusoids in shift order; empty: the bits alone
  int period_px = 0;              // of the sinusoids
  ColumnCode code = ColumnCode::kGray;
  int waves_px = 0;  // kMicroPhase: the period that its waves lie around
};

// Raw mosaics, all of one size and one channel. `black` is the mean of the black frames, raw level.
struct DecodeInput {
  RawView white{};
  ImageView<const float> black{};
  AxisCode columns{};
  AxisCode rows{};
};

struct DecodeOptions {
  // White minus black must exceed both; in standard deviations, and in parts of the range above black level.
  double min_signal_sigmas = 6.0;
  double min_signal_fraction = 0.005;
  // A pair's difference errs by its noise and, beside it, by so much of white minus black: light that does not repeat
  // or that other surfaces send. A wrong bit is improbable (4 sigmas) from 6 % of contrast on; skin leaves 20 to 30 %.
  double pair_sigma_fraction = 0.015;
  // Margin of the bounds on direct and global light, in standard deviations.
  double bound_sigmas = 4.0;
  // A site is kept where its code (with sinusoids: its period) is another one with no more probability than this ...
  double max_astray = 1e-4;
  // ... and its position no less certain: the two finest bits may tell nothing (1.15 px), three may not (2.3 px).
  double max_sigma_px = 1.5;
  // The phase counts when its amplitude exceeds so many standard deviations (phase sigma 0.12 rad at 8).
  double min_amplitude_sigmas = 4.0;
  [[nodiscard]] Status Validate() const;
};

// By number of leading bits that can be trusted, of those that were read (with sinusoids: that number the period).
using TrustedBitCounts = std::array<int64_t, kMaxCodeBits + 1>;

struct DecodeReport {
  DecodedMap map;
  std::array<int64_t, kDecodeReasons> counts{};  // by DecodeReason
  // What is left of a code that is none: lost sites have a place to within one cell of so many bits. 0 where unlit.
  Image<uint8_t> column_bits, row_bits;
  TrustedBitCounts column_bit_counts{}, row_bit_counts{};  // of lit sites
};

// Columns and rows of the projector per camera site; integer = centre of a projector pixel. A site is valid when all
// captured axes are; the other axis' maps are NaN. Waves tell a position by themselves, and sinusoids of the period
// that they lie around add theirs. Of stripes, with sinusoids only the bits coarser than half a period are read (and
// what they are XORed with; all of a code of minimum stripe width); a doubtful bit is accepted where the phase makes
// both of its values agree on the period (only one Gray bit changes at a time). Without them, or where they saturate,
// neighbours on one surface with the site sharpen its position. kUsage: sizes differ, too few bits or shifts, period
// out of range; the message names the frame. Reentrant; the same bits whatever the number of threads.
[[nodiscard]] Result<DecodeReport> DecodeGray(const DecodeInput& input, const SensorNoise& noise,
                                              const DecodeOptions& options = {});

}  // namespace stratalux::fit
