// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/projected_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace stratalux::rig {
namespace {

double NormalBelow(double x) { return 0.5 * std::erfc(-x / std::numbers::sqrt2); }

// Weights at -radius .. radius, of sum 1 and variance sigma^2. (A Gaussian read at whole numbers has less: of 0.5 px
// 0.21 px^2.)
std::vector<double> DiscreteGaussian(double sigma, int radius) {
  std::vector<double> weights(2 * radius + 1);
  const auto variance_of = [&](double s) {
    double sum = 0.0, variance = 0.0;
    for (int k = -radius; k <= radius; ++k) sum += weights[k + radius] = std::exp(-0.5 * k * k / (s * s));
    for (int k = -radius; k <= radius; ++k) variance += (weights[k + radius] /= sum) * k * k;
    return variance;
  };
  double low = 0.05, high = sigma + 1.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (variance_of(middle) < sigma * sigma ? low : high) = middle;
  }
  variance_of(high);
  return weights;
}

}  // namespace

void ApplyGamma(std::span<float> levels, double gamma) {
  if (gamma == 1.0) return;
  for (float& v : levels) v = std::pow(v, static_cast<float>(gamma));
}

std::vector<float> SharedOut(const std::vector<float>& profile, double sigma) {
  if (sigma <= 0.0) return profile;
  const int radius = static_cast<int>(std::ceil(4.0 * sigma)) + 1;
  const auto weights = DiscreteGaussian(sigma, radius);
  const int n = static_cast<int>(profile.size());
  std::vector<float> out(profile.size());
  for (int i = 0; i < n; ++i) {
    double v = 0.0;
    for (int k = -radius; k <= radius; ++k) v += weights[k + radius] * profile[std::clamp(i + k, 0, n - 1)];
    out[i] = static_cast<float>(v);
  }
  return out;
}

Image<float> SharedOut(const Image<float>& image, double sigma) {
  Image<float> out = image;
  for (int y = 0; y < image.height(); ++y) {
    const auto row = SharedOut(std::vector<float>(image.row(y), image.row(y) + image.width()), sigma);
    std::copy(row.begin(), row.end(), out.row(y));
  }
  for (int x = 0; x < image.width(); ++x) {
    std::vector<float> column(image.height());
    for (int y = 0; y < image.height(); ++y) column[y] = out(x, y);
    column = SharedOut(column, sigma);
    for (int y = 0; y < image.height(); ++y) out(x, y) = column[y];
  }
  return out;
}

BlurredBoxes::BlurredBoxes(double sigma) : reach_(static_cast<int>(std::ceil(5.0 * sigma)) + 1) {
  const int taps = 2 * reach_ + 1;
  const double s = std::max(sigma, 1e-6);
  shares_.reserve(static_cast<size_t>(kPhases + 1) * taps);
  for (int phase = 0; phase <= kPhases; ++phase) {
    const double offset = (phase - kPhases / 2) / double{kPhases};  // of the point from the middle pixel
    for (int k = -reach_; k <= reach_; ++k)
      shares_.push_back(static_cast<float>(NormalBelow((k + 0.5 - offset) / s) - NormalBelow((k - 0.5 - offset) / s)));
  }
}

BlurredBoxes::Shares BlurredBoxes::At(float position) const {
  const auto middle = static_cast<int>(std::lround(position));
  const auto phase = static_cast<size_t>(
      std::lround((position - static_cast<float>(middle)) * static_cast<float>(kPhases)) + kPhases / 2);
  const auto taps = static_cast<size_t>(2 * reach_ + 1);
  return {middle - reach_, std::span(shares_).subspan(phase * taps, taps)};
}

LightAlongAxis::LightAlongAxis(std::span<const float> shown, double sigma) : margin_(0) {
  static_assert(BlurredBoxes::kPhases % kNodes == 0);  // nodes are read exactly
  const BlurredBoxes boxes(sigma);
  margin_ = boxes.reach() + 1;
  const auto pixels = static_cast<int>(shown.size());
  const int nodes = (pixels - 1 + 2 * margin_) * kNodes + 1;
  light_.resize(nodes);
  first_.assign(nodes, 0.0);
  second_.assign(nodes, 0.0);
  constexpr double kStep = 1.0 / kNodes;
  for (int i = 0; i < nodes; ++i) {
    const auto shares = boxes.At(static_cast<float>(i) / kNodes - static_cast<float>(margin_));
    double sum = 0.0;
    for (size_t k = 0; k < shares.of.size(); ++k)
      sum += shares.of[k] * shown[std::clamp(shares.first + static_cast<int>(k), 0, pixels - 1)];
    light_[i] = static_cast<float>(sum);
    if (i == 0) continue;
    const double before = light_[i - 1], here = light_[i];
    first_[i] = first_[i - 1] + 0.5 * kStep * (before + here);
    second_[i] = second_[i - 1] + kStep * (first_[i - 1] + kStep * (2.0 * before + here) / 6.0);
  }
}

// A node and how far behind it, pixels; light rises by `slope` a pixel from there.
struct LightAlongAxis::Place {
  size_t node = 0;
  double behind = 0.0, slope = 0.0;
};

// Before the first node and behind the last light is even.
LightAlongAxis::Place LightAlongAxis::PlaceOf(double position) const {
  const double at = (position + margin_) * kNodes, last = static_cast<double>(light_.size() - 1);
  if (at < 0.0) return {0, at / kNodes, 0.0};
  if (at >= last) return {light_.size() - 1, (at - last) / kNodes, 0.0};
  const auto node = static_cast<size_t>(at);
  return {node, (at - static_cast<double>(node)) / kNodes, (double{light_[node + 1]} - light_[node]) * kNodes};
}

double LightAlongAxis::First(double position) const {
  const Place p = PlaceOf(position);
  return first_[p.node] + p.behind * (light_[p.node] + 0.5 * p.behind * p.slope);
}

double LightAlongAxis::Second(double position) const {
  const Place p = PlaceOf(position);
  return second_[p.node] + p.behind * (first_[p.node] + p.behind * (0.5 * light_[p.node] + p.behind * p.slope / 6.0));
}

float LightAlongAxis::Mean(float position, float a, float b) const {
  constexpr float kPoint = 1e-3F;
  if (a < b) std::swap(a, b);
  const double p = position;
  if (a < kPoint) {
    const Place place = PlaceOf(p);
    return static_cast<float>(light_[place.node] + place.behind * place.slope);
  }
  if (b < kPoint) return static_cast<float>((First(p + a) - First(p - a)) / (2.0 * a));
  const double outer = double{a} + b, inner = double{a} - b;
  return static_cast<float>((Second(p + outer) - Second(p + inner) - Second(p - inner) + Second(p - outer)) /
                            (4.0 * a * b));
}

float MeanLight(const Image<float>& shown, const BlurredBoxes& boxes, float column, float row,
                const PixelSides& sides) {
  // Gauss and Legendre's three points of a side of length 1.
  constexpr std::array<float, 3> kAt = {-0.38729833F, 0.0F, 0.38729833F},
                                 kWeight = {5.0F / 18.0F, 8.0F / 18.0F, 5.0F / 18.0F};
  float mean = 0.0F;
  for (size_t j = 0; j < kAt.size(); ++j)
    for (size_t i = 0; i < kAt.size(); ++i) {
      const auto columns = boxes.At(column + kAt[i] * sides.u_column + kAt[j] * sides.v_column),
                 rows = boxes.At(row + kAt[i] * sides.u_row + kAt[j] * sides.v_row);
      float light = 0.0F;
      for (size_t y = 0; y < rows.of.size(); ++y) {
        const float* pixels = shown.row(std::clamp(rows.first + static_cast<int>(y), 0, shown.height() - 1));
        float along = 0.0F;
        for (size_t x = 0; x < columns.of.size(); ++x)
          along += columns.of[x] * pixels[std::clamp(columns.first + static_cast<int>(x), 0, shown.width() - 1)];
        light += rows.of[y] * along;
      }
      mean += kWeight[i] * kWeight[j] * light;
    }
  return mean;
}

}  // namespace stratalux::rig
