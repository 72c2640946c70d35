// SPDX-License-Identifier: Apache-2.0
#include "fitter/skin/skin_mask.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// What is no skin may reflect anything from here up to all light, evenly in its logarithm, and have any share. Where
// skin spreads further than it must, by noise, so does what is no skin: else noise would have no skin in it.
constexpr double kDarkest = 0.001;
constexpr int kMostSweeps = 100;
constexpr double kSettled = 1e-3;  // of a probability

double MedianOf(std::vector<double>& values) {
  const auto middle = values.begin() + std::ssize(values) / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::vector<double> Measured(const SkinLight& light, const Image<float>& map, int colour) {
  std::vector<double> values;
  for (int j = 0; j < map.height(); ++j)
    for (int i = 0; i < map.width(); ++i)
      if (light.reason(i, j) == static_cast<uint8_t>(SkinReason::kMeasured)) values.push_back(map(i, j, colour));
  return values;
}

int ColourOf(const SkinLight& light) {
  int best = 0;
  double largest = 0.0;
  for (int c = 0; c < light.share.channels(); ++c) {
    auto shares = Measured(light, light.share, c);
    const double median = MedianOf(shares);
    if (median > largest) {
      largest = median;
      best = c;
    }
  }
  return best;
}

// Student's t with density normalised over z.
class Student {
 public:
  explicit Student(double freedom)
      : freedom_(freedom),
        log_norm_(std::lgamma(0.5 * (freedom + 1.0)) - std::lgamma(0.5 * freedom) -
                  0.5 * std::log(freedom * std::numbers::pi)) {}
  [[nodiscard]] double LogDensity(double z) const {
    return log_norm_ - 0.5 * (freedom_ + 1.0) * std::log1p(z * z / freedom_);
  }
  // |z| that half of all draws exceed, by halving.
  [[nodiscard]] double MedianDeviation() const {
    double low = 0.0, high = 1.0;
    for (int k = 0; k < 50; ++k) {
      const double middle = 0.5 * (low + high);
      (Within(middle) < 0.5 ? low : high) = middle;
    }
    return low;
  }

 private:
  [[nodiscard]] double Within(double z) const {
    constexpr int kSteps = 200;
    double sum = 0.0;
    for (int k = 0; k < kSteps; ++k) sum += std::exp(LogDensity((k + 0.5) * z / kSteps));
    return 2.0 * sum * z / kSteps;
  }
  double freedom_, log_norm_;
};

SkinTrait MajorityOf(std::vector<double> values, double median_deviation, double least_scale) {
  SkinTrait trait;
  trait.centre = MedianOf(values);
  for (double& v : values) v = std::abs(v - trait.centre);
  trait.scale = std::max(MedianOf(values) / median_deviation, least_scale);
  return trait;
}

// Log of how much likelier the light is of skin than of anything else, in nats; 0 where nothing was measured.
Image<float> EvidenceOf(const SkinLight& light, const SkinOptions& options, SkinMask& mask) {
  const Student student(options.freedom);
  const double deviation = student.MedianDeviation();
  const double log_range = std::log(1.0 / kDarkest) / options.least_log_scale,
               share_range = 1.0 / options.least_share_scale;
  std::vector<double> reflectances = Measured(light, light.reflectance, mask.colour);
  for (double& r : reflectances) r = std::log(r);
  mask.log_reflectance = MajorityOf(std::move(reflectances), deviation, options.least_log_scale);
  mask.share = MajorityOf(Measured(light, light.share, mask.colour), deviation, options.least_share_scale);
  // `range`: of the alternative, in scales of skin.
  const auto likelier = [&](const SkinTrait& trait, double value, double range) {
    return student.LogDensity((value - trait.centre) / trait.scale) + std::log(range);
  };
  Image<float> evidence(light.reason.width(), light.reason.height());
  for (int j = 0; j < evidence.height(); ++j)
    for (int i = 0; i < evidence.width(); ++i) {
      if (light.reason(i, j) != static_cast<uint8_t>(SkinReason::kMeasured)) continue;
      double nats = 0.0;
      if (options.by_reflectance)
        nats += likelier(mask.log_reflectance, std::log(light.reflectance(i, j, mask.colour)), log_range);
      if (options.by_share) nats += likelier(mask.share, light.share(i, j, mask.colour), share_range);
      evidence(i, j) = static_cast<float>(nats);
    }
  return evidence;
}

// How much its neighbours on the surface, of eight, speak for skin: -1 .. 1.
double MindOfNeighbours(const SkinMask& mask, const Image<float>& probability, int i, int j) {
  double sum = 0.0;
  int neighbours = 0;
  for (int y = std::max(j - 1, 0); y <= std::min(j + 1, probability.height() - 1); ++y)
    for (int x = std::max(i - 1, 0); x <= std::min(i + 1, probability.width() - 1); ++x) {
      if ((x == i && y == j) || !mask.HasSurface(x, y)) continue;
      sum += 2.0 * probability(x, y) - 1.0;
      ++neighbours;
    }
  return neighbours == 0 ? 0.0 : sum / neighbours;
}

// Mean field of Potts' two states: p = 1 / (1 + exp(-(evidence + coupling * mind of the neighbours))), until it
// settles.
void Settle(const Image<float>& evidence, double coupling, SkinMask& mask) {
  const auto logistic = [](double nats) { return static_cast<float>(1.0 / (1.0 + std::exp(-nats))); };
  Image<float> probability(evidence.width(), evidence.height());
  for (size_t k = 0; k < evidence.size(); ++k) probability.pixels()[k] = logistic(evidence.pixels()[k]);
  Image<float> next = probability;
  for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
    ParallelFor(evidence.height(), 8, [&](int64_t begin, int64_t end) {
      for (int j = static_cast<int>(begin); j < end; ++j)
        for (int i = 0; i < evidence.width(); ++i)
          if (mask.HasSurface(i, j))
            next(i, j) = logistic(evidence(i, j) + coupling * MindOfNeighbours(mask, probability, i, j));
    });
    float change = 0.0F;
    for (size_t k = 0; k < next.size(); ++k)
      change = std::max(change, std::abs(next.pixels()[k] - probability.pixels()[k]));
    std::swap(next, probability);
    if (change < kSettled) break;
  }
  mask.probability = std::move(probability);
}

void Decide(SkinMask& mask) {
  for (int j = 0; j < mask.skin.height(); ++j)
    for (int i = 0; i < mask.skin.width(); ++i) {
      if (!mask.HasSurface(i, j)) mask.probability(i, j) = std::nanf("");
      // Of no evidence, and neighbours without any: as where no light was separated.
      mask.skin(i, j) = mask.probability(i, j) >= 0.5F ? 1 : 0;
      mask.skin_quads += mask.skin(i, j);
    }
}

}  // namespace

Status SkinOptions::Validate() const {
  if (!(least_log_scale > 0.0) || !(least_share_scale > 0.0) || !(freedom >= 1.0) || !(coupling >= 0.0) ||
      least_quads < 1)
    return Status::Usage("skin: scales and quads are above 0, degrees of freedom from 1 on, the coupling not below 0");
  return Status::Ok();
}

int64_t SkinMask::surface_quads() const {
  int64_t all = 0;
  for (const int64_t count : counts) all += count;
  return all - counts[static_cast<size_t>(SkinReason::kNoSurface)];
}

Result<SkinMask> JudgeSkin(const SkinLight& light, const SkinOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  const int width = light.reason.width(), height = light.reason.height();
  SkinMask mask{Image<float>(width, height), Image<uint8_t>(width, height), light.reason, light.counts};
  mask.told = light.counts[static_cast<size_t>(SkinReason::kMeasured)] >= options.least_quads;
  Image<float> evidence(width, height);
  if (mask.told) {
    mask.colour = ColourOf(light);
    evidence = EvidenceOf(light, options, mask);
    Settle(evidence, options.coupling, mask);
  } else {
    std::ranges::fill(mask.probability.pixels(), 1.0F);
  }
  Decide(mask);
  return mask;
}

SkinMask AllSkin(ImageView<const uint8_t> surface) {
  SkinMask mask{Image<float>(surface.width(), surface.height(), 1, 1.0F),
                Image<uint8_t>(surface.width(), surface.height()), Image<uint8_t>(surface.width(), surface.height())};
  for (size_t k = 0; k < surface.size(); ++k) {
    const auto reason = surface.pixels()[k] != 0 ? SkinReason::kUnlit : SkinReason::kNoSurface;
    mask.reason.pixels()[k] = static_cast<uint8_t>(reason);
    ++mask.counts[static_cast<size_t>(reason)];
  }
  Decide(mask);
  return mask;
}

}  // namespace stratalux::fit
