// SPDX-License-Identifier: Apache-2.0
// How much of a projected sinusoid's contrast each camera site sees (docs/math/separation.md, "Contrast").
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>

#include "fitter/structured_light/sensor_noise.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::fit {

enum class ModulationReason : uint8_t { kValid, kUnlit, kSaturated, kNotFinite };
inline constexpr int kModulationReasons = 4;
[[nodiscard]] const char* ToString(ModulationReason reason);

struct ModulationOptions {
  double min_signal_sigmas = 6.0;  // of the sinusoids' mean less black, per site
  // Of the sensor's range: below, the fixed pattern of black is no longer small.
  double min_signal_fraction = 0.005;
  [[nodiscard]] Status Validate() const;
};

// Raw mosaics of one projector, one size, one channel.
struct ModulationFrames {
  ImageView<const float> black{};                       // mean of its black frames, raw level
  std::span<const ImageView<const uint16_t>> shifts{};  // k/N of a period, in that order, N >= 3
};

struct Modulation {
  Image<float> value;  // per site, NaN where it is not valid
  std::array<int64_t, kModulationReasons> counts{};
};

// amplitude / (mean - black): 1 where a linear projector's light is all direct. The mean is the sinusoids' own: white
// differs from its double by the projector's response curve, and by what its light has drifted. Invalid sites are
// masked, and nothing is clipped. kUsage: fewer than 3 shifts, sizes differ.
[[nodiscard]] Result<Modulation> MeasureModulation(const ModulationFrames& frames, const SensorNoise& noise,
                                                   const ModulationOptions& options = {});

// A rectangle of the picture, px of its frames.
struct Region {
  int x_px = 0, y_px = 0, width_px = 0, height_px = 0;
};

struct SiteMedian {
  int64_t sites = 0;              // finite ones, which it is of
  std::optional<double> value{};  // nullopt: there is none
};
// Of a map's sites. Precondition, of both: the region lies in the map.
[[nodiscard]] SiteMedian MedianIn(ImageView<const float> map, const Region& region);
// Of the quotient at each site where both are finite and `coarse` is not 0. Precondition: both are of one size.
[[nodiscard]] SiteMedian MedianRatioIn(ImageView<const float> fine, ImageView<const float> coarse,
                                       const Region& region);

}  // namespace stratalux::fit
