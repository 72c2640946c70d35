// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/prediction_error.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>
#include <vector>

namespace stratalux::fit {
namespace {

constexpr int kCauses = 4;
// Fewer samples tell no four parts from each other.
constexpr int64_t kLeastSamples = 200;
constexpr double kShareInside = 0.95;
constexpr int kReweightings = 12;

using Causes = Eigen::Matrix<double, kCauses, 1>;

Causes CausesOf(const ErrorCauses& c) {
  const double p = c.prediction, tilted = p * c.tan_incidence, step = c.step, spread = c.spread;
  return {p * p, tilted * tilted, step * step, spread * spread};
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

// The squared error without its noise, in units of which sigma^2 leaves 5 % outside.
double ReachOf(const ErrorSample& s) {
  return double(s.residual) * s.residual / (kInterval95 * kInterval95) - s.noise_variance;
}

// Non-negative least squares of targets by the causes: weigh(sample, sigma^2 + n^2 of it by `parts`) gives weight and
// weight x target.
template <typename Weigh>
Causes Regress(std::span<const ErrorSample* const> samples, const Causes& parts, const Weigh& weigh) {
  Eigen::Matrix<double, kCauses, kCauses> a = Eigen::Matrix<double, kCauses, kCauses>::Zero();
  Causes b = Causes::Zero();
  for (const ErrorSample* s : samples) {
    const Causes causes = CausesOf(s->causes);
    const double scatter = parts.dot(causes) + s->noise_variance;
    if (!(scatter > 0.0)) continue;
    const auto [weight, weighted_target] = weigh(*s, scatter);
    a += weight * causes * causes.transpose();
    b += weighted_target * causes;
  }
  return NonNegativeSolution(a, b);
}

// Quantile regression (Koenker & Bassett 1978; each pass as Hunter & Lange 2000 majorise, in units of what the parts so
// far say): the parts of which kInterval95 sigma leaves 5 % of the errors outside, whichever of them prevails.
Causes PartsOfQuantile(std::span<const ErrorSample* const> samples, Causes parts) {
  constexpr double kFinest = 0.02, kSettled = 1e-3;
  constexpr int kMost = 100;
  for (int pass = 0; pass < kMost; ++pass) {
    const Causes next = Regress(samples, parts, [](const ErrorSample& s, double scatter) {
      const double reach = ReachOf(s), beyond = (reach - (scatter - s.noise_variance)) / scatter;
      const double weight = 1.0 / ((kFinest + std::abs(beyond)) * scatter * scatter);
      return std::pair(weight, weight * reach + (2.0 * kShareInside - 1.0) / scatter);
    });
    if (!(next.maxCoeff() > 0.0)) return parts;
    const bool settled = ((next - parts).array().abs() <= kSettled * parts.array().max(next.array())).all();
    parts = next;
    if (settled) break;
  }
  return parts;
}

// Scaled until 5 % of the samples are outside.
Causes ToReach(std::span<const ErrorSample* const> samples, const Causes& parts) {
  std::vector<double> reached;  // over what the parts say
  for (const ErrorSample* s : samples)
    if (const double variance = parts.dot(CausesOf(s->causes)); variance > 0.0)
      reached.push_back(ReachOf(*s) / variance);
  if (reached.empty()) return parts;
  const auto at = reached.begin() + static_cast<std::ptrdiff_t>(kShareInside * double(reached.size()));
  std::nth_element(reached.begin(), at, reached.end());
  return *at > 0.0 ? Causes(parts * *at) : parts;
}

bool Usable(const ErrorSample& s) {
  return std::isfinite(s.residual) && std::isfinite(s.squared_error) && s.noise_variance >= 0.0F &&
         CausesOf(s.causes).allFinite();
}

}  // namespace

ErrorCauseMaps::ErrorCauseMaps(const SurfaceMap& surface, const Eigen::Vector3d& light_mm,
                               const Image<float>& prediction, const Image<float>& white)
    : prediction_(prediction),
      white_(white),
      tan_incidence_(surface.width(), surface.height()),
      step_(prediction.width(), prediction.height(), prediction.channels()) {
  const auto told = [&](int i, int j, int c) {
    return i >= 0 && j >= 0 && i < surface.width() && j < surface.height() && surface.mask(i, j) != 0 &&
           std::isfinite(prediction(i, j, c));
  };
  const auto share = [&](int i, int j, int c) {
    return white(i, j, c) > 0.0F ? double{prediction(i, j, c)} / white(i, j, c) : 0.0;
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
          // Of both sides' the geometric mean, or a line's dim flank would have the jump to its bright neighbour.
          double along = 1.0;
          int neighbours = 0;
          for (const int side : {-1, 1}) {
            if (!told(i + side * di, j + side * dj, c)) continue;
            along *= std::abs(share(i + side * di, j + side * dj, c) - share(i, j, c));
            ++neighbours;
          }
          if (neighbours > 0) square += neighbours == 2 ? along : along * along;
        }
        step_(i, j, c) = static_cast<float>(white(i, j, c) * std::sqrt(square));
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
    const Causes found = Regress(usable, parts, [](const ErrorSample& s, double scatter) {
      const double weight = 1.0 / (scatter * scatter);
      return std::pair(weight, weight * s.squared_error);
    });
    if (!(found.maxCoeff() > 0.0)) return std::nullopt;  // noise is all there is
    parts = found;
  }
  // How far errors reach only those tell that exceed their noise.
  std::vector<const ErrorSample*> telling;
  std::ranges::copy_if(usable, std::back_inserter(telling),
                       [&](const ErrorSample* s) { return parts.dot(CausesOf(s->causes)) > s->noise_variance; });
  if (static_cast<int64_t>(telling.size()) >= kLeastSamples) parts = ToReach(telling, PartsOfQuantile(usable, parts));
  PredictionError error{std::sqrt(parts[0]), std::sqrt(parts[1]), std::sqrt(parts[2]), std::sqrt(parts[3]),
                        static_cast<int64_t>(usable.size())};
  for (const ErrorSample* s : usable)
    error.most_tan_incidence = std::max<double>(error.most_tan_incidence, s->causes.tan_incidence);
  return error;
}

Image<float> HalfWidths(const SurfaceMap& surface, const Eigen::Vector3d& light_mm, const Image<float>& prediction,
                        const Image<float>& white, std::span<const PredictionError> colours) {
  const ErrorCauseMaps causes(surface, light_mm, prediction, white);
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
