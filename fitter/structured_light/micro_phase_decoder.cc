// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/micro_phase_decoder.h"

#include <algorithm>
#include <array>
#include <optional>
#include <vector>

namespace stratalux::fit {

MicroPhaseDecoder::MicroPhaseDecoder(const AxisCode& code, const SensorNoise& noise, const DecodeOptions& options)
    : code_(code),
      noise_(noise),
      options_(options),
      table_(static_cast<int>(code.shifts.size())),
      search_(code.count, static_cast<int>(code.bits.size()), code.waves_px) {
  // What is unlit has no squares beyond its noise, in the mean.
  constexpr size_t kEvery = 7;
  std::vector<double> squares(code.bits.size());
  for (size_t b = 0; b < code.bits.size(); ++b) {
    const auto& [positive, inverse] = code.bits[b];
    if (!code.bits[b].IsWhole()) return;
    for (size_t site = 0; site < positive.size(); site += kEvery) {
      const double shown = positive.data()[site], other = inverse.data()[site];
      if (std::max(shown, other) >= noise.saturation_dn) continue;
      squares[b] += (shown - other) * (shown - other) - noise.VarianceDn2(shown) - noise.VarianceDn2(other);
    }
  }
  search_.LearnContrast(squares);
}

Position MicroPhaseDecoder::Decode(size_t site, const SiteLight& light) const {
  const size_t planes = code_.bits.size();
  std::array<double, kMaxCodeBits> difference{}, weight{};
  bool lost = false;
  for (size_t b = 0; b < planes; ++b) {
    const PairLight pair = ReadPair(code_.bits[b], site, light, noise_, options_.pair_sigma_fraction);
    const bool saturated = std::max(pair.positive_dn, pair.inverse_dn) >= noise_.saturation_dn ||
                           (light.white_saturated && !code_.bits[b].IsWhole());
    lost |= saturated;
    difference[b] = pair.positive_dn - pair.inverse_dn;
    weight[b] = saturated || code_.bits[b].IsLost() ? 0.0 : 1.0 / (pair.sigma_dn * pair.sigma_dn);
  }
  std::optional<MicroPhaseSearch::Within> within;
  if (!code_.shifts.empty() && code_.period_px == code_.waves_px) {
    const Harmonic h = HarmonicAt(code_.shifts, site, table_, noise_);
    const double px_per_rad = code_.period_px / (2.0 * std::numbers::pi);
    if (h.HasPhase(options_.min_amplitude_sigmas)) {
      // Beside the noise, what a pair's difference errs by: of each of its two frames and of each shift alike.
      const double off = options_.pair_sigma_fraction * light.SignalDn() / std::sqrt(double(code_.shifts.size()));
      within = {h.phase_rad * px_per_rad, std::hypot(h.amplitude_sigma_dn, off) / h.amplitude_dn * px_per_rad};
    }
  }
  const MicroPhaseSearch::Found found =
      search_.Find(std::span(difference).first(planes), std::span(weight).first(planes), within);
  Position position{.source = PositionSource::kPhase};
  if (found.astray > options_.max_astray || found.sigma_px > options_.max_sigma_px) {
    position.reason = lost ? DecodeReason::kSaturated : DecodeReason::kAmbiguous;
    return position;
  }
  position.trusted_bits = static_cast<int>(planes);
  if (found.column < -0.5 || found.column >= code_.count - 0.5) {
    position.reason = DecodeReason::kOutside;
    return position;
  }
  position.value_px = static_cast<float>(found.column);
  position.sigma_px = static_cast<float>(found.sigma_px);
  return position;
}

}  // namespace stratalux::fit
