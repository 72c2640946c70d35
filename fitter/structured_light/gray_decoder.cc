// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/gray_decoder.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "fitter/structured_light/axis_decoder.h"
#include "fitter/structured_light/micro_phase_decoder.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

bool IsCaptured(const AxisCode& code) { return !code.bits.empty() || !code.shifts.empty(); }

Status CheckSize(const char* what, const RawView& view, const RawView& white) {
  if (view.width() == white.width() && view.height() == white.height() && view.channels() == 1) return Status::Ok();
  return Status::Usage(std::string("decode: ") + what + " is " + std::to_string(view.width()) + "x" +
                       std::to_string(view.height()) + ", the white frame " + std::to_string(white.width()) + "x" +
                       std::to_string(white.height()) + "; all frames must be mosaics of one size");
}

Status CheckAxis(const char* name, const AxisCode& code, const RawView& white) {
  const std::string axis(name);
  const int bits = static_cast<int>(code.bits.size());
  if (!IsCaptured(code)) return Status::Ok();
  if (code.count < 1 || bits < 1 || bits > kMaxCodeBits || (1 << bits) < code.count)
    return Status::Usage("decode: " + axis + ": " + std::to_string(bits) + " bits cannot number " +
                         std::to_string(code.count) + " " + axis + "; give all bits of the code");
  for (const CodedBit& bit : code.bits) {
    if (!bit.positive.empty()) SLX_RETURN_IF_ERROR(CheckSize("a Gray frame", bit.positive, white).WithContext(axis));
    if (!bit.inverse.empty())
      SLX_RETURN_IF_ERROR(CheckSize("an inverse Gray frame", bit.inverse, white).WithContext(axis));
  }
  for (const RawView& shift : code.shifts) SLX_RETURN_IF_ERROR(CheckSize("a sinusoid", shift, white).WithContext(axis));
  if (!code.shifts.empty() && (code.shifts.size() < 3 || code.period_px < 3))
    return Status::Usage("decode: " + axis + ": sinusoids need at least 3 shifts and a period of at least 3 px");
  if (!IsOfStripes(code.code) && code.waves_px < 3)
    return Status::Usage("decode: " + axis + ": waves need a period of at least 3 px, not " +
                         std::to_string(code.waves_px));
  return Status::Ok();
}

// Of one axis, by site; `value` and `sigma` are NaN where the reason says so.
struct AxisMap {
  AxisMap(int width, int height)
      : value(width, height, 1, std::nanf("")),
        sigma(width, height, 1, std::nanf("")),
        trusted_bits(width, height),
        reason(width, height),
        from_bits(width, height) {}
  void Put(size_t site, const Position& position) {
    value.data()[site] = position.value_px;
    sigma.data()[site] = position.sigma_px;
    trusted_bits.data()[site] = static_cast<uint8_t>(position.trusted_bits);
    reason.data()[site] = static_cast<uint8_t>(position.reason);
    from_bits.data()[site] = position.source == PositionSource::kBits ? 1 : 0;
  }
  Image<float> value, sigma;
  Image<uint8_t> trusted_bits, reason, from_bits;
};

class MapDecoder {
 public:
  MapDecoder(const DecodeInput& input, const SensorNoise& noise, const DecodeOptions& options)
      : input_(input), noise_(noise), options_(options) {}

  [[nodiscard]] AxisMap Decode(const AxisCode& code) const {
    if (!IsOfStripes(code.code)) return SiteBySite(MicroPhaseDecoder(code, noise_, options_));
    const int width = input_.white.width(), height = input_.white.height();
    const AxisDecoder decoder(code, noise_, options_);
    const AxisMap own = SiteBySite(decoder);
    AxisMap pooled = own;
    ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
      for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y)
        for (int x = 0; x < width; ++x) Pool(decoder, own, x, y, pooled);
    });
    return pooled;
  }

  // White minus black tells; a saturated white is lit all the more.
  [[nodiscard]] bool IsLit(size_t site) const {
    const SiteLight light = LightAt(site);
    const double sigma = std::sqrt(noise_.VarianceDn2(light.white_dn) + noise_.VarianceDn2(light.black_dn));
    const double range = noise_.saturation_dn - noise_.black_level_dn;
    return light.SignalDn() > std::max(options_.min_signal_sigmas * sigma, options_.min_signal_fraction * range);
  }

  // Of a site that is not lit: where white saturates, black hides what light there is.
  [[nodiscard]] DecodeReason WhyNotLit(size_t site) const {
    return LightAt(site).white_saturated ? DecodeReason::kSaturated : DecodeReason::kUnlit;
  }

 private:
  [[nodiscard]] AxisMap SiteBySite(const auto& decoder) const {
    const int width = input_.white.width(), height = input_.white.height();
    AxisMap own(width, height);
    ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
      for (size_t site = begin * width; site < static_cast<size_t>(end) * width; ++site)
        if (IsLit(site)) own.Put(site, decoder.Decode(site, LightAt(site)));
    });
    return own;
  }

  [[nodiscard]] SiteLight LightAt(size_t site) const {
    const double white = input_.white.data()[site];
    return {input_.black.data()[site], white, white >= noise_.saturation_dn};
  }

  // Reads what each site says by itself, whatever became of its neighbours: the order of sites does not matter.
  void Pool(const AxisDecoder& decoder, const AxisMap& own, int x, int y, AxisMap& pooled) const {
    if (own.from_bits(x, y) == 0 || own.reason(x, y) == static_cast<uint8_t>(DecodeReason::kOutside)) return;
    const size_t site = static_cast<size_t>(y) * own.value.width() + x;
    const SiteLight light = LightAt(site);
    const auto neighbours = PredictFromNeighbours(own.value, own.sigma, x, y, decoder.MostProbable(site, light));
    if (!neighbours) return;
    const auto position = decoder.Pool(site, light, *neighbours);
    if (position) pooled.Put(site, *position);
  }

  const DecodeInput& input_;
  const SensorNoise& noise_;
  const DecodeOptions& options_;
};

void CountBits(const Image<uint8_t>& trusted_bits, const Image<uint8_t>& reason, TrustedBitCounts& counts) {
  for (size_t site = 0; site < trusted_bits.size(); ++site)
    if (reason.data()[site] != static_cast<uint8_t>(DecodeReason::kUnlit)) ++counts[trusted_bits.data()[site]];
}

}  // namespace

const char* ToString(DecodeReason reason) {
  constexpr std::array<const char*, kDecodeReasons> kNames = {"valid",     "unlit", "ambiguous",
                                                              "saturated", "moved", "outside"};
  return kNames[static_cast<size_t>(reason)];
}

Status DecodeOptions::Validate() const {
  const std::array<double, 6> values = {min_signal_sigmas, min_signal_fraction,  pair_sigma_fraction,
                                        bound_sigmas,      min_amplitude_sigmas, max_sigma_px};
  for (double v : values)
    if (!(v >= 0.0)) return Status::Usage("decode: thresholds must not be negative, one is " + std::to_string(v));
  if (!(max_astray >= 0.0 && max_astray < 0.5)) return Status::Usage("decode: max_astray must be 0 .. 0.5");
  return Status::Ok();
}

Result<DecodeReport> DecodeGray(const DecodeInput& input, const SensorNoise& noise, const DecodeOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  if (input.white.empty()) return Status::Usage("decode: the white frame is missing");
  if (input.black.width() != input.white.width() || input.black.height() != input.white.height())
    return Status::Usage("decode: the black frame's size differs from the white frame's");
  if (!IsCaptured(input.columns) && !IsCaptured(input.rows))
    return Status::Usage("decode: there is a code neither of columns nor of rows");
  SLX_RETURN_IF_ERROR(CheckAxis("columns", input.columns, input.white));
  SLX_RETURN_IF_ERROR(CheckAxis("rows", input.rows, input.white));

  const int width = input.white.width(), height = input.white.height();
  const MapDecoder decoder(input, noise, options);
  AxisMap columns(width, height), rows(width, height);
  if (IsCaptured(input.columns)) columns = decoder.Decode(input.columns);
  if (IsCaptured(input.rows)) rows = decoder.Decode(input.rows);
  Image<uint8_t> reasons(width, height);
  for (size_t site = 0; site < reasons.size(); ++site) {
    uint8_t reason = columns.reason.data()[site];
    if (reason == 0) reason = rows.reason.data()[site];
    if (!decoder.IsLit(site)) reason = static_cast<uint8_t>(decoder.WhyNotLit(site));
    reasons.data()[site] = reason;
    if (reason == 0) continue;
    for (AxisMap* axis : {&columns, &rows}) axis->value.data()[site] = axis->sigma.data()[site] = std::nanf("");
  }
  DecodeReport report{{std::move(columns.value), std::move(rows.value), std::move(columns.sigma), std::move(rows.sigma),
                       std::move(reasons)},
                      {},
                      std::move(columns.trusted_bits),
                      std::move(rows.trusted_bits),
                      {},
                      {}};
  for (uint8_t reason : report.map.reason.pixels()) ++report.counts[reason];
  CountBits(report.column_bits, report.map.reason, report.column_bit_counts);
  CountBits(report.row_bits, report.map.reason, report.row_bit_counts);
  return report;
}

}  // namespace stratalux::fit
