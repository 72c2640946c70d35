// SPDX-License-Identifier: Apache-2.0
#include "fitter/separation/modulation.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "fitter/structured_light/sinusoid.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// Why a site tells nothing; kValid: it does.
ModulationReason WhyNoModulation(const Harmonic& harmonic, double black_dn, const SensorNoise& noise,
                                 const ModulationOptions& options) {
  if (!std::isfinite(black_dn)) return ModulationReason::kNotFinite;
  if (harmonic.saturated) return ModulationReason::kSaturated;
  const double sigma_dn = std::sqrt(noise.VarianceDn2(harmonic.mean_dn) + noise.VarianceDn2(black_dn));
  const double range_dn = noise.saturation_dn - noise.black_level_dn;
  const double least_dn = std::max(options.min_signal_sigmas * sigma_dn, options.min_signal_fraction * range_dn);
  return harmonic.mean_dn - black_dn > least_dn ? ModulationReason::kValid : ModulationReason::kUnlit;
}

Status SameSizes(const ModulationFrames& frames) {
  const auto differs = [&](const auto& image) {
    return image.width() != frames.black.width() || image.height() != frames.black.height() || image.channels() != 1;
  };
  if (!differs(frames.black) && std::ranges::none_of(frames.shifts, differs)) return Status::Ok();
  return Status::Usage("sinusoids must have one channel and the size of black, " +
                       std::to_string(frames.black.width()) + "x" + std::to_string(frames.black.height()));
}

// Of what `at` gives of the region's sites, as far as it is finite.
template <typename At>
SiteMedian MedianOfSites(const Region& region, const At& at) {
  std::vector<float> values;
  values.reserve(static_cast<size_t>(region.width_px) * static_cast<size_t>(region.height_px));
  for (int y = region.y_px; y < region.y_px + region.height_px; ++y)
    for (int x = region.x_px; x < region.x_px + region.width_px; ++x)
      if (const float value = at(x, y); std::isfinite(value)) values.push_back(value);
  if (values.empty()) return {};
  const auto middle = values.begin() + std::ssize(values) / 2;
  std::ranges::nth_element(values, middle);
  return {std::ssize(values), *middle};
}

}  // namespace

const char* ToString(ModulationReason reason) {
  constexpr std::array<const char*, kModulationReasons> kNames = {"valid", "unlit", "saturated", "not_finite"};
  return kNames[static_cast<size_t>(reason)];
}

Status ModulationOptions::Validate() const {
  for (const double value : {min_signal_sigmas, min_signal_fraction})
    if (!std::isfinite(value) || value < 0.0) return Status::Usage("modulation: options must be finite and at least 0");
  return Status::Ok();
}

Result<Modulation> MeasureModulation(const ModulationFrames& frames, const SensorNoise& noise,
                                     const ModulationOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  if (frames.shifts.size() < 3)
    return Status::Usage("modulation needs at least 3 shifts of a sinusoid, not " +
                         std::to_string(frames.shifts.size()));
  SLX_RETURN_IF_ERROR(SameSizes(frames));
  const int width = frames.black.width(), height = frames.black.height();
  const ShiftTable table(static_cast<int>(frames.shifts.size()));
  Modulation modulation{Image<float>(width, height, 1, std::nanf("")), {}};
  Image<uint8_t> reasons(width, height);
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (size_t site = begin * width; site < static_cast<size_t>(end) * width; ++site) {
      const double black = frames.black.data()[site];
      const Harmonic harmonic = HarmonicAt(frames.shifts, site, table, noise);
      const ModulationReason reason = WhyNoModulation(harmonic, black, noise, options);
      if (reason == ModulationReason::kValid)
        modulation.value.data()[site] = static_cast<float>(harmonic.amplitude_dn / (harmonic.mean_dn - black));
      reasons.data()[site] = static_cast<uint8_t>(reason);
    }
  });
  for (const uint8_t reason : reasons.pixels()) ++modulation.counts[reason];
  return modulation;
}

SiteMedian MedianIn(ImageView<const float> map, const Region& region) {
  return MedianOfSites(region, [&](int x, int y) { return map(x, y); });
}

SiteMedian MedianRatioIn(ImageView<const float> fine, ImageView<const float> coarse, const Region& region) {
  return MedianOfSites(region, [&](int x, int y) { return fine(x, y) / coarse(x, y); });
}

}  // namespace stratalux::fit
