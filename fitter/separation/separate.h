// SPDX-License-Identifier: Apache-2.0
// Direct and global light from high-frequency patterns [Nayar et al. 2006] (model section 4,
// docs/math/separation.md).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "fitter/separation/separation_map.h"
#include "fitter/structured_light/sensor_noise.h"
#include "shared/base/result.h"
#include "shared/image/pixel_format.h"

namespace stratalux::fit {

inline constexpr int kSeparationReasons = 5;
[[nodiscard]] const char* ToString(SeparationReason reason);

struct SeparationOptions {
  double projector_black = 0.0;  // b: black over white of the projector (ProjectorCalibration::black_level)
  // a_1: Fourier coefficient of the sinusoids' light as the projector gives it
  // (ProjectorCalibration::SinusoidAmplitude)
  double sinusoid_amplitude = 0.5;
  double min_signal_sigmas = 6.0;  // of white minus black, per quad and channel
  // A component below minus so many of its standard deviations is negative: invalid, never clipped.
  double negative_sigmas = 4.0;
  [[nodiscard]] Status Validate() const;
};

// Raw mosaics of one projector, one size, one channel. `black`: mean of its black frames, raw level.
struct SeparationFrames {
  ImageView<const uint16_t> white{};
  ImageView<const float> black{};
  // Shifted sinusoids of full contrast along columns and along rows; one of the two may be empty.
  std::vector<ImageView<const uint16_t>> column_shifts{};
  std::vector<ImageView<const uint16_t>> row_shifts{};
  // Shifted checkerboards, half of each lit.
  std::vector<ImageView<const uint16_t>> checkerboards{};
};

struct Separation {
  SeparationMap map;  // on quads x channels of the mosaic (mono: sites)
  std::array<int64_t, kSeparationReasons> counts{};
};

// With p = b + (1 - b)(a_0 + a_1 cos + ...) projected, L = L_d p + L_g mean(p); black frame removed:
//   L_d = amplitude / (a_1 (1 - b)),   L_d + L_g = (white - black) / (1 - b).
// A linear projector has a_0 = a_1 = 1/2; the further harmonics of another one miss the amplitude, but for those that
// N shifts cannot tell from the first (the third, for N = 4).
// The amplitude is the mean of both axes', over the quad's sites of the colour. kUsage: no sinusoid, or sizes differ.
[[nodiscard]] Result<Separation> SeparateSinusoids(const SeparationFrames& frames, Cfa cfa, const SensorNoise& noise,
                                                   const SeparationOptions& options = {});

// Where no pattern was captured: all light under white, by the same formula, and nothing of what is direct (kNotTold).
[[nodiscard]] Result<Separation> WhiteAlone(const SeparationFrames& frames, Cfa cfa, const SensorNoise& noise,
                                            const SeparationOptions& options = {});

// Extremes over the shifts, ambient removed, lit fraction a = 1/2, as printed in [Nayar et al. 2006]:
//   L+ = L_d + (a + b (1 - a)) L_g,   L- = b L_d + ((1 - a) + a b) L_g.
[[nodiscard]] Result<Separation> SeparateCheckerboards(const SeparationFrames& frames, Cfa cfa,
                                                       const SensorNoise& noise, const SeparationOptions& options = {});

}  // namespace stratalux::fit
