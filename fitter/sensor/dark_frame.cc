// SPDX-License-Identifier: Apache-2.0
#include "fitter/sensor/dark_frame.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"
#include "shared/image/box_sums.h"

namespace stratalux::fit {
namespace {

constexpr int kReach = 2;  // sites of the same colour on either side
// The same where white guides: 961 sites know the two numbers of a line to a twentieth of one site's noise, which a sum
// of 64 samples then carries 3 times over where their own noise is 8 times as much as one's.
constexpr int kGuidedReach = 15;
// Fewer sites tell no line.
constexpr double kLeastSites = 50.0;
constexpr float kOutlierSigmas = 4.0F, kKeptSigmas = 6.0F;

double NoiseVariance(double level_dn, int count, const CameraCalibration& camera) {
  const double photons = std::max(level_dn - camera.black_level_dn, 0.0) / camera.gain_e_per_dn;
  return (camera.read_noise_dn * camera.read_noise_dn + photons + 1.0 / 12.0) / count;  // 1/12: quantisation
}

float NoiseSigma(float level_dn, int count, const CameraCalibration& camera) {
  return static_cast<float>(std::sqrt(NoiseVariance(level_dn, count, camera)));
}

// Mean of the neighbours that lie near their median.
float LocalMean(const MeanFrame& mean, int x, int y, int step, const CameraCalibration& camera) {
  std::array<float, (2 * kReach + 1) * (2 * kReach + 1)> values{};
  size_t n = 0;
  for (int j = y - kReach * step; j <= y + kReach * step; j += step)
    for (int i = x - kReach * step; i <= x + kReach * step; i += step)
      if (mean.dn.contains(i, j)) values[n++] = mean.dn(i, j);
  auto middle = values.begin() + static_cast<std::ptrdiff_t>(n / 2);
  std::nth_element(values.begin(), middle, values.begin() + static_cast<std::ptrdiff_t>(n));
  const float median = *middle, limit = kOutlierSigmas * NoiseSigma(median, mean.count, camera);
  float sum = 0.0F;
  int kept = 0;
  for (size_t k = 0; k < n; ++k)
    if (std::abs(values[k] - median) <= limit) {
      sum += values[k];
      ++kept;
    }
  return sum / static_cast<float>(kept);  // the median itself is always kept
}

// One colour's sites of a mosaic, (first_x + step i, first_y + step j).
struct Sites {
  int first_x = 0, first_y = 0, step = 1, width = 0, height = 0;
  [[nodiscard]] int X(int i) const { return first_x + step * i; }
  [[nodiscard]] int Y(int j) const { return first_y + step * j; }
};

template <typename Each>
void ForEachSite(const Sites& sites, const Each& each) {
  ParallelFor(sites.height, 16, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < sites.width; ++i) each(i, j);
  });
}

// Around each site the line black = a + b white, by the sites that lie near what `estimate` says; where there is one,
// it becomes the estimate.
void GuideByWhite(const Sites& sites, const MeanFrame& black, const MeanFrame& white, const CameraCalibration& camera,
                  Image<float>& estimate) {
  // 1, white, black, white^2, white black, and the noise of white: what a line through noisy whites would be too flat
  // by is less than that, and without it white that does not vary would draw a line of its noise.
  Image<double> moments(sites.width, sites.height, 6);
  ForEachSite(sites, [&](int i, int j) {
    const int x = sites.X(i), y = sites.Y(j);
    const float said = estimate(x, y), level = black.dn(x, y);
    const double w = white.dn(x, y);
    if (!std::isfinite(w) || !(std::abs(level - said) <= kOutlierSigmas * NoiseSigma(said, black.count, camera)))
      return;
    const std::array<double, 6> values = {1.0, w, level, w * w, w * level, NoiseVariance(w, white.count, camera)};
    std::copy(values.begin(), values.end(), &moments(i, j));
  });
  const Image<double> sums = BoxSums(moments, kGuidedReach);
  ForEachSite(sites, [&](int i, int j) {
    const int x = sites.X(i), y = sites.Y(j);
    const double w = white.dn(x, y), n = sums(i, j, 0);
    if (!std::isfinite(w) || n < kLeastSites) return;
    const double mean_white = sums(i, j, 1) / n, mean_black = sums(i, j, 2) / n;
    const double variance = std::max(sums(i, j, 3) / n - mean_white * mean_white, 0.0) + sums(i, j, 5) / n;
    const double slope = (sums(i, j, 4) / n - mean_white * mean_black) / variance;
    estimate(x, y) = static_cast<float>(mean_black + slope * (w - mean_white));
  });
}

}  // namespace

Image<float> QuietDarkFrame(const MeanFrame& black, const CameraCalibration& camera, const MeanFrame& white) {
  // Greens lie on every second site of a row; rows and columns two apart hold the same colour in any mosaic.
  const int step = QuadStep(camera.cfa);
  const int width = black.dn.width(), height = black.dn.height();
  Image<float> estimate(width, height);
  for (int first_y = 0; first_y < step; ++first_y)
    for (int first_x = 0; first_x < step; ++first_x) {
      const Sites sites = {first_x, first_y, step, (width - first_x + step - 1) / step,
                           (height - first_y + step - 1) / step};
      ForEachSite(sites, [&](int i, int j) {
        const int x = sites.X(i), y = sites.Y(j);
        estimate(x, y) = LocalMean(black, x, y, step, camera);
      });
      // Twice: near an edge of light the mean of neighbours takes good sites for hot ones.
      for (int pass = 0; pass < 2 && !white.dn.empty(); ++pass) GuideByWhite(sites, black, white, camera, estimate);
    }
  // Deviations in units of the noise; their median absolute value is 0.6745 where noise alone makes them.
  const auto levels = black.dn.pixels();
  std::vector<float> deviations(levels.size());
  for (size_t i = 0; i < deviations.size(); ++i)
    deviations[i] = std::abs(levels[i] - estimate.pixels()[i]) / NoiseSigma(estimate.pixels()[i], black.count, camera);
  std::vector<float> sorted = deviations;
  auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  const float variance = (*middle / 0.6745F) * (*middle / 0.6745F);
  const float share = variance > 1.0F ? 1.0F - 1.0F / variance : 0.0F;
  for (size_t i = 0; i < deviations.size(); ++i)
    estimate.pixels()[i] += (deviations[i] > kKeptSigmas ? 1.0F : share) * (levels[i] - estimate.pixels()[i]);
  return estimate;
}

}  // namespace stratalux::fit
