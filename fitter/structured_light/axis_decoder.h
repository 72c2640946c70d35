// SPDX-License-Identifier: Apache-2.0
// One axis of a code of stripes at one camera site: the bits' probabilities, the phase where there is one, the position
// that follows (docs/math/geometry.md, eq. 2 to 8).
#pragma once

#include <optional>

#include "fitter/structured_light/code_word.h"
#include "fitter/structured_light/neighbour_plane.h"
#include "fitter/structured_light/sinusoid.h"
#include "fitter/structured_light/site_reading.h"

namespace stratalux::fit {

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
  struct Reading {
    CodeWord word;
    bool pair_lost = false;
  };

  [[nodiscard]] double ProbabilityOfOne(const PairLight& pair, const SiteLight& light, double direct_dn) const;
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
