// SPDX-License-Identifier: Apache-2.0
// Decoding of Gray codes with inverses, refined by the phase of shifted sinusoids where there are any
// (model section 3, docs/math/geometry.md).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "fitter/structured_light/decoded_map.h"
#include "fitter/structured_light/sensor_noise.h"
#include "shared/base/result.h"

namespace stratalux::fit {

using RawView = ImageView<const uint16_t>;

struct CodedBit {
  RawView positive;
  RawView inverse;
};

// One axis of one projector.
struct AxisCode {
  int count = 0;                  // columns (or rows) of the projector
  std::vector<CodedBit> bits{};   // reflected Gray code, most significant first
  std::vector<RawView> shifts{};  // sinusoids in shift order; empty: the bits alone, to the pixel
  int period_px = 0;              // of the sinusoids
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
  // A bit is certain when |positive - inverse| exceeds both; skin blurs fine stripes to 20-30 % contrast.
  double min_bit_sigmas = 4.0;
  double min_bit_contrast = 0.06;  // of white minus black
  // The phase counts when its amplitude exceeds so many standard deviations (phase sigma 0.12 rad at 8).
  double min_amplitude_sigmas = 8.0;
  [[nodiscard]] Status Validate() const;
};

struct DecodeReport {
  DecodedMap map;
  std::array<int64_t, kDecodeReasons> counts{};  // by DecodeReason
};

// Columns and rows of the projector per camera site; integer = centre of a projector pixel. A site is valid when both
// axes are. With sinusoids only the bits coarser than half a period are read; a doubtful bit is accepted where the
// phase makes both of its values agree on the period (only one Gray bit changes at a time).
// kUsage: sizes differ, too few bits or shifts, period out of range; the message names the frame. Reentrant; the same
// bits whatever the number of threads.
[[nodiscard]] Result<DecodeReport> DecodeGray(const DecodeInput& input, const SensorNoise& noise,
                                              const DecodeOptions& options = {});

}  // namespace stratalux::fit
