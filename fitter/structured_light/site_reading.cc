// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/site_reading.h"

#include <algorithm>

namespace stratalux::fit {

// A saturated frame holds at least its level: beside an unsaturated one the difference is a lower bound, and its sign
// right. Where one of the pair was not captured, white and black together less the other stand for it: the difference
// is 2 (positive - (white + black) / 2), or that with the inverse and the other sign.
PairLight ReadPair(const CodedBit& frames, size_t site, const SiteLight& light, const SensorNoise& noise,
                   double systematic) {
  const double off = systematic * light.SignalDn();
  PairLight pair;
  double variance = off * off;
  if (frames.IsLost()) {
    pair.sigma_dn = std::sqrt(variance) + noise.saturation_dn;
    return pair;
  }
  if (!frames.IsWhole()) {
    const double shown = frames.positive.empty() ? frames.inverse.data()[site] : frames.positive.data()[site];
    const double other = light.white_dn + light.black_dn - shown;
    // Half of a saturated white is no threshold; what lies below it lies below the true one, too.
    pair.lost = light.white_saturated && shown > other;
    pair.positive_dn = frames.positive.empty() ? other : shown;
    pair.inverse_dn = frames.positive.empty() ? shown : other;
    variance += 4.0 * noise.VarianceDn2(shown) + noise.VarianceDn2(light.white_dn) + noise.VarianceDn2(light.black_dn);
  } else {
    pair.positive_dn = frames.positive.data()[site];
    pair.inverse_dn = frames.inverse.data()[site];
    pair.lost = std::min(pair.positive_dn, pair.inverse_dn) >= noise.saturation_dn;
    variance += noise.VarianceDn2(pair.positive_dn) + noise.VarianceDn2(pair.inverse_dn);
  }
  pair.sigma_dn = std::sqrt(variance);
  return pair;
}

}  // namespace stratalux::fit
