// SPDX-License-Identifier: Apache-2.0
#include "fitter/sensor/dark_frame.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include "shared/base/parallel_each.h"
#include "shared/geometry/quad.h"
#include "shared/image/box_sums.h"

namespace stratalux::fit {
namespace {

constexpr int kReach = 2;  // sites of the same colour on either side
// Where white guides: 961 sites know the two numbers of a line to a twentieth of one site's noise, which a sum of 64
// samples then carries 3 times over where their own noise is 8 times as much as one's. Farther away light of the room
// and of the projector need not fall in one proportion.
constexpr int kGuidedReach = 15;
// Fewer sites tell no line.
constexpr double kLeastSites = 50.0;
constexpr float kOutlierSigmas = 4.0F, kKeptSigmas = 6.0F;
// So many times what noise makes, a variance of some 80 sites is not its alone (it scatters by half of it).
constexpr double kClearly = 2.0;

double NoiseVariance(double level_dn, int count, const CameraCalibration& camera) {
  const double photons = std::max(level_dn - camera.black_level_dn, 0.0) / camera.gain_e_per_dn;
  return (camera.read_noise_dn * camera.read_noise_dn + photons + 1.0 / 12.0) / count;  // 1/12: quantisation
}

float NoiseSigma(float level_dn, int count, const CameraCalibration& camera) {
  return static_cast<float>(std::sqrt(NoiseVariance(level_dn, count, camera)));
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

constexpr int kWindow = (2 * kReach + 1) * (2 * kReach + 1);
constexpr int kTogether = 8;  // sites whose windows are sorted side by side
using Values = Eigen::Array<float, kTogether, 1>;
using Windows = std::array<Values, kWindow>;

// By forgetful selection: of half of the values and one more, neither the least nor the greatest is the median of all.
Values MedianOf(Windows values) {
  size_t first = 0;
  constexpr size_t kLast = kWindow / 2 + 1;
  const auto sort = [&](size_t a, size_t b) {
    const Values least = values[a].min(values[b]);
    values[b] = values[a].max(values[b]);
    values[a] = least;
  };
  for (size_t next = kLast + 1;; ++next) {
    for (size_t k = first + 1; k <= kLast; ++k) sort(first, k);
    ++first;
    for (size_t k = first; k < kLast; ++k) sort(k, kLast);
    if (next == kWindow) return values[first];
    values[kLast] = values[next];
  }
}

// Of a line of one colour's plane, means of those around each site that lie near their median. Beyond the picture its
// outermost sites are repeated.
void MeansAround(const Image<float>& plane, int j, int count, const CameraCalibration& camera, std::span<float> means) {
  const int width = plane.width();
  std::array<std::vector<float>, 2 * kReach + 1> lines;
  for (int b = 0; b < std::ssize(lines); ++b) {
    const int y = std::clamp(j + b - kReach, 0, plane.height() - 1);
    for (int i = -kReach; i < width + kReach + kTogether; ++i)
      lines[static_cast<size_t>(b)].push_back(plane(std::clamp(i, 0, width - 1), y));
  }
  for (int i = 0; i < width; i += kTogether) {
    Windows windows;
    for (size_t k = 0; k < windows.size(); ++k)
      windows[k] = Eigen::Map<const Values>(lines[k / lines.size()].data() + i + k % lines.size());
    const Values median = MedianOf(windows);
    Values limit, sum = Values::Zero(), kept = Values::Zero();
    for (int k = 0; k < kTogether; ++k) limit[k] = kOutlierSigmas * NoiseSigma(median[k], count, camera);
    for (const Values& value : windows) {
      const auto near = (value - median).abs() <= limit;
      sum += near.select(value, 0.0F);
      kept += near.cast<float>();
    }
    sum /= kept;  // the median itself is always kept
    std::copy_n(sum.data(), std::min(kTogether, width - i), means.begin() + i);
  }
}

void TakeMeansAround(const Sites& sites, const MeanFrame& black, const CameraCalibration& camera,
                     Image<float>& estimate) {
  Image<float> plane(sites.width, sites.height);
  ForEachSite(sites, [&](int i, int j) { plane(i, j) = black.dn(sites.X(i), sites.Y(j)); });
  ParallelFor(sites.height, 16, [&](int64_t begin, int64_t end) {
    std::vector<float> means(static_cast<size_t>(sites.width));
    for (int j = static_cast<int>(begin); j < end; ++j) {
      MeansAround(plane, j, black.count, camera, means);
      for (int i = 0; i < sites.width; ++i) estimate(sites.X(i), sites.Y(j)) = means[static_cast<size_t>(i)];
    }
  });
}

// Around each site the line black = a + b white, by the sites that lie near what `estimate` says; where there is one,
// it becomes the estimate.
void GuideByWhite(const Sites& sites, const MeanFrame& black, const MeanFrame& white, const CameraCalibration& camera,
                  Image<float>& estimate, Image<uint8_t>& guided) {
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
    guided(x, y) = 1;
  });
}

// What the lines leave. Where a shadow's edge or a mirror lies within reach, light of the room and of the projector are
// no longer in one proportion, and no line fits: means of the residual over 5 x 5 sites then scatter by more than noise
// makes them, and are added by the share of their variance that it does not explain.
void AddWhatNoLineFits(const Sites& sites, const MeanFrame& black, const CameraCalibration& camera,
                       const Image<uint8_t>& guided, Image<float>& estimate) {
  Image<double> moments(sites.width, sites.height, 3);  // sites that count, residual, noise's variance
  ForEachSite(sites, [&](int i, int j) {
    const int x = sites.X(i), y = sites.Y(j);
    const double residual = black.dn(x, y) - estimate(x, y), noise = NoiseVariance(estimate(x, y), black.count, camera);
    if (guided(x, y) == 0 || !(residual * residual <= kOutlierSigmas * kOutlierSigmas * noise)) return;
    const std::array<double, 3> values = {1.0, residual, noise};
    std::copy(values.begin(), values.end(), &moments(i, j));
  });
  const Image<double> near = BoxSums(moments, kReach);
  Image<double> squares(sites.width, sites.height, 2);  // mean residual squared, its noise's variance
  ForEachSite(sites, [&](int i, int j) {
    const double n = near(i, j, 0);
    if (n < 1.0) return;
    const std::array<double, 2> values = {std::pow(near(i, j, 1) / n, 2), near(i, j, 2) / (n * n)};
    std::copy(values.begin(), values.end(), &squares(i, j));
  });
  const Image<double> around = BoxSums(squares, 2 * kReach);
  ForEachSite(sites, [&](int i, int j) {
    const int x = sites.X(i), y = sites.Y(j);
    if (guided(x, y) == 0 || near(i, j, 0) < 1.0 || !(around(i, j, 0) > 0.0)) return;
    const double by_noise = around(i, j, 1) / around(i, j, 0);
    const double share = kClearly * by_noise > 1.0 ? 0.0 : 1.0 - by_noise;
    estimate(x, y) += static_cast<float>(share * near(i, j, 1) / near(i, j, 0));
  });
}

// The share of the deviations' variance that noise does not explain, of sites that white guides or does not; 0 without
// any. Where noise alone makes them, the median of their absolute values is 0.6745.
float UnexplainedShare(const std::vector<float>& deviations, const Image<uint8_t>& guided, uint8_t of) {
  std::vector<float> these;
  for (size_t i = 0; i < deviations.size(); ++i)
    if (guided.pixels()[i] == of) these.push_back(deviations[i]);
  if (these.empty()) return 0.0F;
  const auto middle = these.begin() + static_cast<std::ptrdiff_t>(these.size() / 2);
  std::nth_element(these.begin(), middle, these.end());
  const float variance = (*middle / 0.6745F) * (*middle / 0.6745F);
  return variance > 1.0F ? 1.0F - 1.0F / variance : 0.0F;
}

}  // namespace

Image<float> QuietDarkFrame(const MeanFrame& black, const CameraCalibration& camera, const MeanFrame& white) {
  // Greens lie on every second site of a row; rows and columns two apart hold the same colour in any mosaic.
  const int step = QuadStep(camera.cfa);
  const int width = black.dn.width(), height = black.dn.height();
  Image<float> estimate(width, height);
  Image<uint8_t> guided(width, height);
  ParallelEach(static_cast<size_t>(step) * step, [&](size_t colour) {
    const int first_x = static_cast<int>(colour) % step, first_y = static_cast<int>(colour) / step;
    const Sites sites = {first_x, first_y, step, (width - first_x + step - 1) / step,
                         (height - first_y + step - 1) / step};
    TakeMeansAround(sites, black, camera, estimate);
    // Twice: near an edge of light the mean of neighbours takes good sites for hot ones.
    for (int pass = 0; pass < 2 && !white.dn.empty(); ++pass)
      GuideByWhite(sites, black, white, camera, estimate, guided);
    if (!white.dn.empty()) AddWhatNoLineFits(sites, black, camera, guided, estimate);
  });
  // Deviations in units of the noise.
  const auto levels = black.dn.pixels();
  std::vector<float> deviations(levels.size());
  ParallelFor(std::ssize(deviations), 1 << 15, [&](int64_t begin, int64_t end) {
    for (auto i = static_cast<size_t>(begin); i < static_cast<size_t>(end); ++i)
      deviations[i] =
          std::abs(levels[i] - estimate.pixels()[i]) / NoiseSigma(estimate.pixels()[i], black.count, camera);
  });
  const std::array<float, 2> shares = {UnexplainedShare(deviations, guided, 0),
                                       UnexplainedShare(deviations, guided, 1)};
  for (size_t i = 0; i < deviations.size(); ++i) {
    const float share = deviations[i] > kKeptSigmas ? 1.0F : shares[guided.pixels()[i]];
    estimate.pixels()[i] += share * (levels[i] - estimate.pixels()[i]);
  }
  return estimate;
}

}  // namespace stratalux::fit
