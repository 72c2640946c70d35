// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/prediction_error.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "fitter/mixture/standard_errors.h"
#include "shared/image/box_sums.h"

namespace stratalux::fit {
namespace {

constexpr int kCauses = 4;
// Fewer samples tell no four parts from each other.
constexpr int64_t kLeastSamples = 200;
// Within so far light comes from that is seen beside where it entered.
constexpr double kAroundMm = 5.0;
constexpr double kShareInside = 0.95;
constexpr int kReweightings = 12;

using Causes = Eigen::Matrix<double, kCauses, 1>;

Causes CausesOf(const ErrorCauses& c) {
  const double p = c.prediction, tilted = p * c.tan_incidence, step = c.step, around = c.around;
  return {p * p, tilted * tilted, step * step, around * around};
}

// The least squares solution of normal equations without a negative part: the best of all choices of which are 0.
Causes NonNegativeSolution(const Eigen::Matrix<double, kCauses, kCauses>& a, const Causes& b) {
  Causes best = Causes::Zero();
  double least = 0.0;  // of x' a x - 2 x' b, 0 for none
  for (unsigned chosen = 1; chosen < (1U << kCauses); ++chosen) {
    Eigen::Matrix<double, kCauses, kCauses> of = a;
    Causes to = b;
    for (int k = 0; k < kCauses; ++k) {
      if ((chosen >> k & 1U) != 0) continue;
      of.row(k).setZero();
      of.col(k).setZero();
      of(k, k) = 1.0;
      to[k] = 0.0;
    }
    const Causes x = of.ldlt().solve(to);
    const double cost = x.dot(a * x) - 2.0 * x.dot(b);
    if (x.allFinite() && x.minCoeff() >= 0.0 && cost < least) {
      least = cost;
      best = x;
    }
  }
  return best;
}

bool Usable(const ErrorSample& s) {
  return std::isfinite(s.residual) && std::isfinite(s.squared_error) && s.noise_variance >= 0.0F &&
         CausesOf(s.causes).allFinite();
}

// Mean of the values around each pixel that are told, over squares of 2 radius + 1.
Image<float> MeanAround(const Image<float>& image, const Image<uint8_t>& told, int radius) {
  const int colours = image.channels();
  Image<double> values(image.width(), image.height(), 2 * colours);
  for (int j = 0; j < image.height(); ++j)
    for (int i = 0; i < image.width(); ++i)
      for (int c = 0; c < colours; ++c) {
        if (told(i, j) == 0 || !std::isfinite(image(i, j, c))) continue;
        values(i, j, c) = image(i, j, c);
        values(i, j, colours + c) = 1.0;
      }
  const Image<double> sums = BoxSums(values, radius);
  Image<float> mean(image.width(), image.height(), colours);
  for (int j = 0; j < image.height(); ++j)
    for (int i = 0; i < image.width(); ++i)
      for (int c = 0; c < colours; ++c)
        if (sums(i, j, colours + c) > 0.5) mean(i, j, c) = static_cast<float>(sums(i, j, c) / sums(i, j, colours + c));
  return mean;
}

}  // namespace

ErrorCauseMaps::ErrorCauseMaps(const SurfaceMap& surface, const Eigen::Vector3d& light_mm,
                               const Image<float>& prediction)
    : prediction_(prediction),
      tan_incidence_(surface.width(), surface.height()),
      step_(prediction.width(), prediction.height(), prediction.channels()) {
  const double quad_mm = QuadSpacingMm(surface);
  const int radius = quad_mm > 0.0 ? std::max(1, static_cast<int>(std::lround(kAroundMm / quad_mm))) : 1;
  around_ = MeanAround(prediction, surface.mask, radius);
  const auto told = [&](int i, int j, int c) {
    return i >= 0 && j >= 0 && i < surface.width() && j < surface.height() && surface.mask(i, j) != 0 &&
           std::isfinite(prediction(i, j, c));
  };
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const Eigen::Vector3d to_light = (light_mm - surface.Point(i, j)).normalized();
      const double cosine = std::clamp(to_light.dot(surface.Normal(i, j)), 1e-3, 1.0);
      tan_incidence_(i, j) = static_cast<float>(std::sqrt(1.0 - cosine * cosine) / cosine);
      for (int c = 0; c < prediction.channels(); ++c) {
        double square = 0.0;
        for (const auto& [di, dj] : {std::pair(1, 0), {0, 1}}) {
          double along = 0.0, neighbours = 0.0;
          for (const int side : {-1, 1}) {
            if (!told(i + side * di, j + side * dj, c)) continue;
            const double step = prediction(i + side * di, j + side * dj, c) - prediction(i, j, c);
            along += step * step;
            neighbours += 1.0;
          }
          if (neighbours > 0.0) square += along / neighbours;
        }
        step_(i, j, c) = static_cast<float>(std::sqrt(square));
      }
    }
}

double PredictionError::Sigma(const ErrorCauses& causes) const {
  const Causes parts(albedo * albedo, normal_rad * normal_rad, placement_quads * placement_quads, spread * spread);
  ErrorCauses within = causes;
  within.tan_incidence = std::min(within.tan_incidence, static_cast<float>(most_tan_incidence));
  return std::sqrt(parts.dot(CausesOf(within)));
}

std::optional<PredictionError> LearnPredictionError(std::span<const ErrorSample> samples) {
  std::vector<const ErrorSample*> usable;
  for (const ErrorSample& s : samples)
    if (Usable(s)) usable.push_back(&s);
  if (static_cast<int64_t>(usable.size()) < kLeastSamples) return std::nullopt;
  // A squared error of variance v and noise n^2 scatters by sqrt(2) (v + n^2): v as of the parts found before.
  Causes parts = Causes::Constant(1e-4);
  for (int pass = 0; pass < kReweightings; ++pass) {
    Eigen::Matrix<double, kCauses, kCauses> a = Eigen::Matrix<double, kCauses, kCauses>::Zero();
    Causes b = Causes::Zero();
    for (const ErrorSample* s : usable) {
      const Causes causes = CausesOf(s->causes);
      const double scatter = parts.dot(causes) + s->noise_variance;
      if (!(scatter > 0.0)) continue;
      a += causes * causes.transpose() / (scatter * scatter);
      b += causes * (s->squared_error / (scatter * scatter));
    }
    const Causes found = NonNegativeSolution(a, b);
    if (!(found.maxCoeff() > 0.0)) return std::nullopt;  // noise is all there is
    parts = found;
  }
  PredictionError error{std::sqrt(parts[0]), std::sqrt(parts[1]), std::sqrt(parts[2]),
                        std::sqrt(parts[3]), kInterval95,         static_cast<int64_t>(usable.size())};
  for (const ErrorSample* s : usable)
    error.most_tan_incidence = std::max<double>(error.most_tan_incidence, s->causes.tan_incidence);
  // How far errors reach beyond sigma only those tell that exceed their noise.
  std::vector<double> half_widths;
  for (const ErrorSample* s : usable) {
    const double sigma = error.Sigma(s->causes);
    if (!(sigma * sigma > s->noise_variance)) continue;
    const double beyond = double(s->residual) * s->residual - kInterval95 * kInterval95 * s->noise_variance;
    half_widths.push_back(std::sqrt(std::max(beyond, 0.0)) / sigma);
  }
  if (static_cast<int64_t>(half_widths.size()) < kLeastSamples) return error;
  const auto at = half_widths.begin() + static_cast<std::ptrdiff_t>(kShareInside * double(half_widths.size()));
  std::nth_element(half_widths.begin(), at, half_widths.end());
  error.interval = *at;
  return error;
}

Image<float> HalfWidths(const SurfaceMap& surface, const Eigen::Vector3d& light_mm, const Image<float>& prediction,
                        std::span<const PredictionError> colours) {
  const ErrorCauseMaps causes(surface, light_mm, prediction);
  Image<float> half(prediction.width(), prediction.height(), prediction.channels());
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      for (int c = 0; c < prediction.channels() && surface.mask(i, j) != 0; ++c)
        half(i, j, c) = static_cast<float>(colours[c].HalfWidth(causes.At(i, j, c)));
  return half;
}

double ShareWithin(std::span<const ErrorSample> samples, const PredictionError& error) {
  int64_t all = 0, within = 0;
  for (const ErrorSample& s : samples) {
    if (!Usable(s)) continue;
    const double half = error.HalfWidth(s.causes);
    ++all;
    within += double(s.residual) * s.residual <= half * half + kInterval95 * kInterval95 * s.noise_variance ? 1 : 0;
  }
  return all > 0 ? double(within) / double(all) : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace stratalux::fit
