// SPDX-License-Identifier: Apache-2.0
// One axis of the code at one camera site: the bits' probabilities, the phase where there is one, the position that
// follows (docs/math/geometry.md, eq. 2 to 8).
#pragma once

#include <cmath>
#include <optional>

#include "fitter/structured_light/code_word.h"
#include "fitter/structured_light/gray_decoder.h"
#include "fitter/structured_light/neighbour_plane.h"
#include "fitter/structured_light/sinusoid.h"

namespace stratalux::fit {

// Levels of one site, raw.
struct SiteLight {
  double black_dn = 0.0;
  double white_dn = 0.0;
  bool white_saturated = false;  // then the signal is more than the difference
  [[nodiscard]] double SignalDn() const { return white_dn - black_dn; }
};

enum class PositionSource { kPhase, kBits };

struct Position {
  float value_px = std::nanf("");
  float sigma_px = std::nanf("");
  int trusted_bits = 0;  // leading ones, of those that were read
  DecodeReason reason = DecodeReason::kValid;
  PositionSource source = PositionSource::kBits;
};

class AxisDecoder {
 public:
  AxisDecoder(const AxisCode& code, const SensorNoise& noise, const DecodeOptions& options);

  // By the site's own frames. From bits, a position may still be wider than options.max_sigma_px.
  [[nodiscard]] Position Decode(size_t site, const SiteLight& light) const;
  // Column (or row) that the bits alone make most probable.
  [[nodiscard]] double MostProbable(size_t site, const SiteLight& light) const;
  // Decode's position from bits again, with what the neighbours say: of the columns that the bits allow, those where
  // the site's surroundings want it. nullopt where both do not go together.
  [[nodiscard]] std::optional<Position> Pool(size_t site, const SiteLight& light,
                                             const PlanePrediction& neighbours) const;

 private:
  struct Pair {
    double positive_dn = 0.0, inverse_dn = 0.0;  // raw; the inverse made up where none was captured
    double sigma_dn = 0.0;                       // of their difference
    bool lost = false;                           // to saturation
  };
  struct Reading {
    CodeWord word;
    bool pair_lost = false;
  };

  [[nodiscard]] Pair PairAt(size_t bit, size_t site, const SiteLight& light) const;
  [[nodiscard]] double ProbabilityOfOne(const Pair& pair, const SiteLight& light, double direct_dn) const;
  [[nodiscard]] Reading Read(size_t site, const SiteLight& light, int bits, double direct_dn) const;
  // Probability that a code's base lit the site, by the sinusoid's phase.
  [[nodiscard]] double BaseByPhase(const Harmonic& h) const;
  [[nodiscard]] Position FromBits(size_t site, const SiteLight& light) const;
  [[nodiscard]] Position FromPhase(size_t site, const SiteLight& light, const Harmonic& h) const;

  const AxisCode& code_;
  const SensorNoise& noise_;
  const DecodeOptions& options_;
  ShiftTable table_;
  int all_bits_ = 0;
  bool finer_than_phase_ = false;  // stripes that are read beside the sinusoids are narrower than their half period
  int period_bits_ = 0;            // that number the period
  int cell_px_ = 1;                // of those bits
};

}  // namespace stratalux::fit
