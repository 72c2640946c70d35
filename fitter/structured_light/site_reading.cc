// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/site_reading.h"

#include <algorithm>

namespace stratalux::fit {

// A saturated frame holds at least its level: beside an unsaturated one the difference is a lower bound, and its sign
// right. Where no inverse was captured, white and black together less the positive stand for it: the difference is
// 2 (positive - (white + black) / 2).
PairLight ReadPair(const CodedBit& frames, size_t site, const SiteLight& light, const SensorNoise& noise,
                   double systematic) {
  const double off = systematic * light.SignalDn();
  PairLight pair{.positive_dn = static_cast<double>(frames.positive.data()[site])};
  double variance = off * off;
  if (frames.inverse.empty()) {
    pair.inverse_dn = light.white_dn + light.black_dn - pair.positive_dn;
    // Half of a saturated white is no threshold; what lies below it lies below the true one, too.
    pair.lost = light.white_saturated && pair.positive_dn > pair.inverse_dn;
    variance += 4.0 * noise.VarianceDn2(pair.positive_dn) + noise.VarianceDn2(light.white_dn) +
                noise.VarianceDn2(light.black_dn);
  } else {
    pair.inverse_dn = frames.inverse.data()[site];
    pair.lost = std::min(pair.positive_dn, pair.inverse_dn) >= noise.saturation_dn;
    variance += noise.VarianceDn2(pair.positive_dn) + noise.VarianceDn2(pair.inverse_dn);
  }
  pair.sigma_dn = std::sqrt(variance);
  return pair;
}

}  // namespace stratalux::fit
