// SPDX-License-Identifier: Apache-2.0
#include "fitter/sensor/dark_frame.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr int kReach = 2;  // sites of the same colour on either side
constexpr float kOutlierSigmas = 4.0F, kKeptSigmas = 6.0F;

float NoiseSigma(float level_dn, int count, const CameraCalibration& camera) {
  const double photons = std::max(level_dn - camera.black_level_dn, 0.0) / camera.gain_e_per_dn;
  const double variance = camera.read_noise_dn * camera.read_noise_dn + photons + 1.0 / 12.0;  // quantisation
  return static_cast<float>(std::sqrt(variance / count));
}

// Mean of the neighbours that lie near their median.
float LocalMean(const Image<float>& mean, int x, int y, int step, int count, const CameraCalibration& camera) {
  std::array<float, (2 * kReach + 1) * (2 * kReach + 1)> values{};
  size_t n = 0;
  for (int j = y - kReach * step; j <= y + kReach * step; j += step)
    for (int i = x - kReach * step; i <= x + kReach * step; i += step)
      if (mean.contains(i, j)) values[n++] = mean(i, j);
  auto middle = values.begin() + static_cast<std::ptrdiff_t>(n / 2);
  std::nth_element(values.begin(), middle, values.begin() + static_cast<std::ptrdiff_t>(n));
  const float median = *middle, limit = kOutlierSigmas * NoiseSigma(median, count, camera);
  float sum = 0.0F;
  int kept = 0;
  for (size_t k = 0; k < n; ++k)
    if (std::abs(values[k] - median) <= limit) {
      sum += values[k];
      ++kept;
    }
  return sum / static_cast<float>(kept);  // the median itself is always kept
}

}  // namespace

Image<float> QuietDarkFrame(const Image<float>& mean_dn, int count, const CameraCalibration& camera) {
  // Greens lie on every second site of a row; rows and columns two apart hold the same colour in any mosaic.
  const int step = QuadStep(camera.cfa);
  Image<float> local(mean_dn.width(), mean_dn.height());
  ParallelFor(mean_dn.height(), 16, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < mean_dn.width(); ++x) local(x, y) = LocalMean(mean_dn, x, y, step, count, camera);
  });
  // Deviations in units of the noise; their median absolute value is 0.6745 where noise alone makes them.
  std::vector<float> deviations(mean_dn.size());
  for (size_t i = 0; i < deviations.size(); ++i)
    deviations[i] = std::abs(mean_dn.pixels()[i] - local.pixels()[i]) / NoiseSigma(local.pixels()[i], count, camera);
  std::vector<float> sorted = deviations;
  auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  const float variance = (*middle / 0.6745F) * (*middle / 0.6745F);
  const float share = variance > 1.0F ? 1.0F - 1.0F / variance : 0.0F;
  Image<float> dark = local;
  for (size_t i = 0; i < dark.size(); ++i)
    dark.pixels()[i] += (deviations[i] > kKeptSigmas ? 1.0F : share) * (mean_dn.pixels()[i] - local.pixels()[i]);
  return dark;
}

}  // namespace stratalux::fit
