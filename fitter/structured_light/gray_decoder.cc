// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/gray_decoder.h"

#include <bit>
#include <cmath>
#include <numbers>
#include <string>

#include "fitter/structured_light/sinusoid.h"
#include "shared/base/parallel.h"
#include "shared/pattern/pattern.h"

namespace stratalux::fit {
namespace {

constexpr int kMaxDoubtfulBits = 2;

struct Position {
  double value_px = 0.0;
  double sigma_px = 0.0;
  DecodeReason reason = DecodeReason::kValid;
};

// Levels of one site: white minus black, and the direct part as far as the sinusoids tell.
struct SiteLight {
  double black_dn = 0.0;
  double signal_dn = 0.0;
  double direct_dn = 0.0;
};

class AxisDecoder {
 public:
  AxisDecoder(const AxisCode& code, const SensorNoise& noise, const DecodeOptions& options)
      : code_(code), noise_(noise), options_(options), table_(static_cast<int>(code.shifts.size())) {
    const int bits = static_cast<int>(code.bits.size());
    // Largest power of two <= period / 2: cells of that many columns number the period without doubt.
    if (!code.shifts.empty()) cell_ = static_cast<int>(std::bit_floor(static_cast<unsigned>(code.period_px / 2)));
    cell_ = std::min(cell_, 1 << bits);
    used_bits_ = bits - std::countr_zero(static_cast<unsigned>(cell_));
  }

  [[nodiscard]] Position Decode(size_t site, SiteLight light) const {
    if (code_.shifts.empty()) return DecodeCells(site, light);
    const Harmonic h = HarmonicAt(code_.shifts, site, table_, noise_);
    if (h.saturated) return {.reason = DecodeReason::kSaturated};
    if (h.amplitude_dn < options_.min_amplitude_sigmas * h.amplitude_sigma_dn)
      return {.reason = DecodeReason::kAmbiguous};
    light.direct_dn = std::min(2.0 * h.amplitude_dn, light.signal_dn);
    return DecodePhase(site, light, h);
  }

 private:
  struct Word {
    unsigned gray = 0;
    std::array<unsigned, kMaxDoubtfulBits> doubtful{};  // masks
    int doubts = 0;
    bool saturated = false;
  };

  [[nodiscard]] Word ReadBits(size_t site, const SiteLight& light) const {
    Word word;
    for (int b = 0; b < used_bits_; ++b) {
      const double positive = code_.bits[b].positive.data()[site];
      const double inverse = code_.bits[b].inverse.data()[site];
      word.saturated |= std::max(positive, inverse) >= noise_.saturation_dn;
      const unsigned mask = 1U << (used_bits_ - 1 - b);
      if (positive > inverse) word.gray |= mask;
      if (IsCertain(positive, inverse, light)) continue;
      if (word.doubts < kMaxDoubtfulBits) word.doubtful[word.doubts] = mask;
      ++word.doubts;
    }
    return word;
  }

  // Bounds after Xu & Aliaga 2007: of the pair, the directly lit frame holds at least the direct part, the other one at
  // most the global part.
  [[nodiscard]] bool IsCertain(double positive, double inverse, const SiteLight& light) const {
    const double sigma = std::sqrt(noise_.VarianceDn2(positive) + noise_.VarianceDn2(inverse));
    const double contrast = std::abs(positive - inverse);
    if (contrast < options_.min_bit_sigmas * sigma) return false;
    if (contrast < options_.min_bit_contrast * light.signal_dn) return false;
    const double margin = options_.min_bit_sigmas * sigma;
    const double brighter = std::max(positive, inverse) - light.black_dn;
    const double darker = std::min(positive, inverse) - light.black_dn;
    return brighter > light.direct_dn - margin && darker < light.signal_dn - light.direct_dn + margin;
  }

  [[nodiscard]] Position DecodeCells(size_t site, const SiteLight& light) const {
    const Word word = ReadBits(site, light);
    if (word.saturated) return {.reason = DecodeReason::kSaturated};
    if (word.doubts > 0) return {.reason = DecodeReason::kAmbiguous};
    const unsigned cell = BinaryFromGray(word.gray);
    if (static_cast<int>(cell) >= code_.count) return {.reason = DecodeReason::kOutside};
    return {static_cast<double>(cell), 1.0 / std::sqrt(12.0)};  // uniform over one column
  }

  // Number of the period whose phase position `within` (from its first edge) lies nearest to the centre of the cell.
  [[nodiscard]] double PeriodNumber(unsigned gray, double within) const {
    const double centre = (BinaryFromGray(gray) + 0.5) * cell_;
    return std::round((centre - within) / code_.period_px);
  }

  [[nodiscard]] Position DecodePhase(size_t site, const SiteLight& light, const Harmonic& h) const {
    const double within = h.phase_rad / (2.0 * std::numbers::pi) * code_.period_px;
    const Word word = ReadBits(site, light);
    if (word.saturated) return {.reason = DecodeReason::kSaturated};
    if (word.doubts > kMaxDoubtfulBits) return {.reason = DecodeReason::kAmbiguous};
    const double number = PeriodNumber(word.gray, within);
    for (unsigned choice = 1; choice < (1U << word.doubts); ++choice) {
      unsigned gray = word.gray;
      for (int d = 0; d < word.doubts; ++d)
        if ((choice >> d) & 1U) gray ^= word.doubtful[d];
      if (PeriodNumber(gray, within) != number) return {.reason = DecodeReason::kAmbiguous};
    }
    const double column = number * code_.period_px + within - 0.5;
    if (column < -0.5 || column >= code_.count - 0.5) return {.reason = DecodeReason::kOutside};
    const double phase_sigma = h.amplitude_sigma_dn / h.amplitude_dn;
    return {column, phase_sigma * code_.period_px / (2.0 * std::numbers::pi)};
  }

  const AxisCode& code_;
  const SensorNoise& noise_;
  const DecodeOptions& options_;
  ShiftTable table_;
  int cell_ = 1;
  int used_bits_ = 0;
};

Status CheckSize(const char* what, const RawView& view, const RawView& white) {
  if (view.width() == white.width() && view.height() == white.height() && view.channels() == 1) return Status::Ok();
  return Status::Usage(std::string("decode: ") + what + " is " + std::to_string(view.width()) + "x" +
                       std::to_string(view.height()) + ", the white frame " + std::to_string(white.width()) + "x" +
                       std::to_string(white.height()) + "; all frames must be mosaics of one size");
}

Status CheckAxis(const char* name, const AxisCode& code, const RawView& white) {
  const std::string axis(name);
  const int bits = static_cast<int>(code.bits.size());
  if (code.count < 1 || bits < 1 || bits > 16 || (1 << bits) < code.count)
    return Status::Usage("decode: " + axis + ": " + std::to_string(bits) + " bits cannot number " +
                         std::to_string(code.count) + " " + axis + "; give all bits of the code");
  for (const CodedBit& bit : code.bits) {
    SLX_RETURN_IF_ERROR(CheckSize("a Gray frame", bit.positive, white).WithContext(axis));
    SLX_RETURN_IF_ERROR(CheckSize("an inverse Gray frame", bit.inverse, white).WithContext(axis));
  }
  for (const RawView& shift : code.shifts) SLX_RETURN_IF_ERROR(CheckSize("a sinusoid", shift, white).WithContext(axis));
  if (!code.shifts.empty() && (code.shifts.size() < 3 || code.period_px < 3))
    return Status::Usage("decode: " + axis + ": sinusoids need at least 3 shifts and a period of at least 3 px");
  return Status::Ok();
}

struct SiteDecoder {
  const DecodeInput& input;
  const SensorNoise& noise;
  const DecodeOptions& options;
  AxisDecoder columns{input.columns, noise, options};
  AxisDecoder rows{input.rows, noise, options};

  void Decode(size_t site, DecodedMap& map) const {
    const double white = input.white.data()[site];
    const double black = input.black.data()[site];
    const SiteLight light{black, white - black, 0.0};
    const double sigma = std::sqrt(noise.VarianceDn2(white) + noise.VarianceDn2(black));
    const double range = noise.saturation_dn - noise.black_level_dn;
    DecodeReason reason = DecodeReason::kValid;
    Position column, row;
    if (white >= noise.saturation_dn) {
      reason = DecodeReason::kSaturated;
    } else if (!(light.signal_dn > std::max(options.min_signal_sigmas * sigma, options.min_signal_fraction * range))) {
      reason = DecodeReason::kUnlit;
    } else {
      column = columns.Decode(site, light);
      reason = column.reason;
      if (reason == DecodeReason::kValid) row = rows.Decode(site, light);
      if (reason == DecodeReason::kValid) reason = row.reason;
    }
    map.reason.data()[site] = static_cast<uint8_t>(reason);
    if (reason != DecodeReason::kValid) return;
    map.column.data()[site] = static_cast<float>(column.value_px);
    map.row.data()[site] = static_cast<float>(row.value_px);
    map.column_sigma.data()[site] = static_cast<float>(column.sigma_px);
    map.row_sigma.data()[site] = static_cast<float>(row.sigma_px);
  }
};

}  // namespace

const char* ToString(DecodeReason reason) {
  constexpr std::array<const char*, kDecodeReasons> kNames = {"valid",     "unlit", "ambiguous",
                                                              "saturated", "moved", "outside"};
  return kNames[static_cast<size_t>(reason)];
}

Status DecodeOptions::Validate() const {
  const std::array<double, 5> values = {min_signal_sigmas, min_signal_fraction, min_bit_sigmas, min_bit_contrast,
                                        min_amplitude_sigmas};
  for (double v : values)
    if (!(v >= 0.0)) return Status::Usage("decode: thresholds must not be negative, one is " + std::to_string(v));
  if (min_bit_contrast >= 1.0) return Status::Usage("decode: min_bit_contrast must be below 1");
  return Status::Ok();
}

Result<DecodeReport> DecodeGray(const DecodeInput& input, const SensorNoise& noise, const DecodeOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  if (input.white.empty()) return Status::Usage("decode: the white frame is missing");
  if (input.black.width() != input.white.width() || input.black.height() != input.white.height())
    return Status::Usage("decode: the black frame's size differs from the white frame's");
  SLX_RETURN_IF_ERROR(CheckAxis("columns", input.columns, input.white));
  SLX_RETURN_IF_ERROR(CheckAxis("rows", input.rows, input.white));

  const int width = input.white.width(), height = input.white.height();
  const float nan = std::nanf("");
  DecodeReport report{
      {Image<float>(width, height, 1, nan), Image<float>(width, height, 1, nan), Image<float>(width, height, 1, nan),
       Image<float>(width, height, 1, nan), Image<uint8_t>(width, height)},
      {}};
  const SiteDecoder decoder{input, noise, options};
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (size_t site = begin * width; site < static_cast<size_t>(end) * width; ++site) decoder.Decode(site, report.map);
  });
  for (uint8_t reason : report.map.reason.pixels()) ++report.counts[reason];
  return report;
}

}  // namespace stratalux::fit
