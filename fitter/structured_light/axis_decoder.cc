// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/axis_decoder.h"

#include <algorithm>
#include <bit>
#include <numbers>

namespace stratalux::fit {
namespace {

double NormalDensity(double z) { return std::exp(-0.5 * z * z) / std::sqrt(2.0 * std::numbers::pi); }
double NormalShare(double z) { return 0.5 * std::erfc(-z / std::numbers::sqrt2); }

}  // namespace

AxisDecoder::AxisDecoder(const AxisCode& code, const SensorNoise& noise, const DecodeOptions& options)
    : code_(code),
      noise_(noise),
      options_(options),
      table_(static_cast<int>(code.shifts.size())),
      all_bits_(static_cast<int>(code.bits.size())),
      period_bits_(all_bits_) {
  if (code.shifts.empty()) return;
  finer_than_phase_ = code.code != ColumnCode::kGray && 2 * NarrowestStripe(code.code, all_bits_) < code.period_px;
  if (code.code == ColumnCode::kMinStripe) return;  // all of its planes number the period
  // Largest power of two <= period / 2: cells of that many columns number the period without doubt.
  cell_px_ = static_cast<int>(std::bit_floor(static_cast<unsigned>(code.period_px / 2)));
  cell_px_ = std::min(cell_px_, 1 << all_bits_);
  period_bits_ = all_bits_ - std::countr_zero(static_cast<unsigned>(cell_px_));
}

// Bounds after Xu & Aliaga 2007: of the pair, the directly lit frame holds at least the direct part, the other one at
// most the global part. A pair that breaks them tells nothing, whatever its contrast.
double AxisDecoder::ProbabilityOfOne(const PairLight& pair, const SiteLight& light, double direct_dn) const {
  constexpr double kNothing = 0.5;
  if (pair.lost) return kNothing;
  const double margin = options_.bound_sigmas * pair.sigma_dn;
  const double brighter = std::max(pair.positive_dn, pair.inverse_dn) - light.black_dn;
  const double darker = std::min(pair.positive_dn, pair.inverse_dn) - light.black_dn;
  if (brighter < direct_dn - margin) return kNothing;
  if (!light.white_saturated && darker > light.SignalDn() - direct_dn + margin) return kNothing;
  constexpr double kCertain = 8.3;  // from there on the share is 1 to the last bit: its exponential is saved
  const double z = (pair.positive_dn - pair.inverse_dn) / pair.sigma_dn;
  if (std::abs(z) > kCertain) return z > 0.0 ? 1.0 : 0.0;
  return NormalShare(z);
}

AxisDecoder::Reading AxisDecoder::Read(size_t site, const SiteLight& light, int bits, double direct_dn) const {
  Reading reading{CodeWord(code_.code, all_bits_)};
  // Stripes finer than the sinusoid's half period are blurred more than it: no pixel of theirs need have all its direct
  // light.
  if (finer_than_phase_) direct_dn = 0.0;
  const auto one = [&](int plane) {
    const PairLight pair =
        ReadPair(code_.bits[static_cast<size_t>(plane)], site, light, noise_, options_.pair_sigma_fraction);
    reading.pair_lost |= pair.lost;
    return ProbabilityOfOne(pair, light, direct_dn);
  };
  for (int b = 0; b < bits; ++b) reading.word.Push(one(b));
  if (reading.word.EndsBeforeBase()) reading.word.SetBase(one(reading.word.base()));
  return reading;
}

Position AxisDecoder::Decode(size_t site, const SiteLight& light) const {
  if (code_.shifts.empty()) return FromBits(site, light);
  const Harmonic h = HarmonicAt(code_.shifts, site, table_, noise_);
  return h.HasPhase(options_.min_amplitude_sigmas) ? FromPhase(site, light, h) : FromBits(site, light);
}

Position AxisDecoder::FromBits(size_t site, const SiteLight& light) const {
  const Reading reading = Read(site, light, all_bits_, 0.0);
  Position position{.trusted_bits = reading.word.TrustedBits(options_.max_astray), .source = PositionSource::kBits};
  const CodeSpread spread = reading.word.Spread();
  if (spread.astray > options_.max_astray) {
    position.reason = reading.pair_lost ? DecodeReason::kSaturated : DecodeReason::kAmbiguous;
  } else if (static_cast<int>(reading.word.MostProbable()) >= code_.count) {
    position.reason = DecodeReason::kOutside;
  } else {
    position.value_px = static_cast<float>(spread.mean);
    position.sigma_px = static_cast<float>(spread.sigma);
    if (spread.sigma > options_.max_sigma_px)
      position.reason = reading.pair_lost ? DecodeReason::kSaturated : DecodeReason::kAmbiguous;
  }
  return position;
}

// The base repeats in each period of the sinusoid, where its own period divides that: its stripes of half a period are
// lit from a quarter to three quarters of it. Light that scatters may move edges of stripes and phase unlike.
double AxisDecoder::BaseByPhase(const Harmonic& h) const {
  constexpr double kEdge_px = 0.25;  // standard deviation of where an edge lies by the phase
  constexpr double kSurest = 1e-6;
  const int base_px = 4 << (all_bits_ - 1 - *BasePlane(code_.code, all_bits_));
  if (code_.period_px % base_px != 0) return 0.5;
  const double px_per_rad = code_.period_px / (2.0 * std::numbers::pi);
  const double within = std::fmod(h.phase_rad * px_per_rad, base_px);
  const double inside = 0.25 * base_px - std::abs(within - 0.5 * base_px);
  const double sigma = std::hypot(kEdge_px, h.amplitude_sigma_dn / h.amplitude_dn * px_per_rad);
  return std::clamp(NormalShare(inside / sigma), kSurest, 1.0 - kSurest);
}

Position AxisDecoder::FromPhase(size_t site, const SiteLight& light, const Harmonic& h) const {
  const double direct_dn =
      light.white_saturated ? 2.0 * h.amplitude_dn : std::min(2.0 * h.amplitude_dn, light.SignalDn());
  Reading reading = Read(site, light, period_bits_, direct_dn);
  if (reading.word.HasBase()) reading.word.WeighBase(BaseByPhase(h));
  Position position{.trusted_bits = reading.word.TrustedBits(options_.max_astray), .source = PositionSource::kPhase};
  position.reason = reading.pair_lost ? DecodeReason::kSaturated : DecodeReason::kAmbiguous;
  // The period whose phase position (`within`, from its first edge) lies nearest to the cell's centre; a doubtful bit
  // is none where its other value gives the same period.
  const double within = h.phase_rad / (2.0 * std::numbers::pi) * code_.period_px;
  const auto period_of = [&](unsigned cell) {
    return std::round(((cell + 0.5) * cell_px_ - within) / code_.period_px);
  };
  const unsigned middle = reading.word.MostProbable();
  const double number = period_of(middle);
  double mass = 0.0;
  const unsigned last = (1U << period_bits_) - 1;
  for (unsigned cell = middle; period_of(cell) == number; --cell) {
    mass += reading.word.Probability(cell);
    if (cell == 0) break;
  }
  for (unsigned cell = middle + 1; cell <= last && period_of(cell) == number; ++cell)
    mass += reading.word.Probability(cell);
  if (mass < 1.0 - options_.max_astray) return position;
  const double column = number * code_.period_px + within - 0.5;
  if (column < -0.5 || column >= code_.count - 0.5) {
    position.reason = DecodeReason::kOutside;
    return position;
  }
  position.reason = DecodeReason::kValid;
  position.value_px = static_cast<float>(column);
  position.sigma_px =
      static_cast<float>(h.amplitude_sigma_dn / h.amplitude_dn * code_.period_px / (2.0 * std::numbers::pi));
  return position;
}

double AxisDecoder::MostProbable(size_t site, const SiteLight& light) const {
  return Read(site, light, all_bits_, 0.0).word.MostProbable();
}

// With the prior N(mu, s^2) of the neighbours and the probability P_c of every cell c, the column's density is P_c
// times the prior within each cell. Its moments about mu, a = (c - 1/2 - mu) / s, b = (c + 1/2 - mu) / s:
//   S0 = sum P_c (Phi(b) - Phi(a)),  S1 = s sum P_c (phi(a) - phi(b)),
//   S2 = s^2 sum P_c (Phi(b) - Phi(a) + a phi(a) - b phi(b)).
std::optional<Position> AxisDecoder::Pool(size_t site, const SiteLight& light,
                                          const PlanePrediction& neighbours) const {
  constexpr double kTogether = 0.05;  // a site of which they say otherwise keeps its own code
  const Reading reading = Read(site, light, all_bits_, 0.0);
  const double mu = neighbours.value_px, s = neighbours.sigma_px;
  const auto middle = static_cast<int>(std::lround(mu));
  const int reach = 1 + static_cast<int>(std::ceil(4.0 * s));
  double s0 = 0.0, s1 = 0.0, s2 = 0.0;
  for (int cell = std::max(middle - reach, 0); cell <= std::min(middle + reach, code_.count - 1); ++cell) {
    const double probability = reading.word.Probability(static_cast<unsigned>(cell));
    const double a = (cell - 0.5 - mu) / s, b = (cell + 0.5 - mu) / s;
    const double share = NormalShare(b) - NormalShare(a);
    s0 += probability * share;
    s1 += probability * s * (NormalDensity(a) - NormalDensity(b));
    s2 += probability * s * s * (share + a * NormalDensity(a) - b * NormalDensity(b));
  }
  if (!(s0 > kTogether)) return std::nullopt;
  const double shift = s1 / s0;
  Position position{.trusted_bits = reading.word.TrustedBits(options_.max_astray), .source = PositionSource::kBits};
  position.value_px = static_cast<float>(mu + shift);
  // Quantisation errs alike at all of them, so that both together are no surer than the surer one.
  const double sigma =
      std::max(std::sqrt(std::max(0.0, s2 / s0 - shift * shift)), std::min(s, reading.word.Spread().sigma));
  if (sigma > options_.max_sigma_px) return std::nullopt;
  position.sigma_px = static_cast<float>(sigma);
  return position;
}

}  // namespace stratalux::fit
