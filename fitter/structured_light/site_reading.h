// SPDX-License-Identifier: Apache-2.0
// What decoders of one camera site read, and what they say of it.
#pragma once

#include <cmath>

#include "fitter/structured_light/gray_decoder.h"

namespace stratalux::fit {

// Levels of one site, raw.
struct SiteLight {
  double black_dn = 0.0;
  double white_dn = 0.0;
  bool white_saturated = false;  // then the signal is more than the difference
  [[nodiscard]] double SignalDn() const { return white_dn - black_dn; }
};

// A plane of the code and its inverse.
struct PairLight {
  double positive_dn = 0.0, inverse_dn = 0.0;  // raw; one is made up where it was not captured, alike where neither was
  double sigma_dn = 0.0;                       // of their difference
  bool lost = false;                           // to saturation
};

// `systematic`: of the site's signal, that the difference errs by beside its noise (DecodeOptions).
[[nodiscard]] PairLight ReadPair(const CodedBit& frames, size_t site, const SiteLight& light, const SensorNoise& noise,
                                 double systematic);

enum class PositionSource { kPhase, kBits };

struct Position {
  float value_px = std::nanf("");
  float sigma_px = std::nanf("");
  int trusted_bits = 0;  // leading ones, of those that were read
  DecodeReason reason = DecodeReason::kValid;
  PositionSource source = PositionSource::kBits;
};

}  // namespace stratalux::fit
