// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>

#include "firmware-host/simulated/table_tool/people.h"

namespace stratalux::rig {
namespace {

constexpr size_t kFitted = 5;
using Point = std::array<double, kFitted>;

Point PointOf(const Population& p) {
  return {std::log(p.melanin_span), p.melanin_shift, std::log(p.scattering_spread), std::log(p.blood_median),
          std::log(p.blood_spread)};
}

Population PopulationAt(const Point& x, Population like) {
  like.melanin_span = std::exp(x[0]);
  like.melanin_shift = x[1];
  like.scattering_spread = std::exp(x[2]);
  like.blood_median = std::exp(x[3]);
  like.blood_spread = std::exp(x[4]);
  return like;
}

struct Corner {
  Point at{};
  double cost = 0.0;
};

// A point on the line from `from` through `to`; 1 is `to`.
Point Along(const Point& from, const Point& to, double t) {
  Point at{};
  for (size_t k = 0; k < kFitted; ++k) at[k] = from[k] + t * (to[k] - from[k]);
  return at;
}

}  // namespace

double PeopleCost(const PeopleSummary& s) {
  double cost = 0.0;
  const auto add = [&](double deviation, double scale) { cost += std::pow(deviation / scale, 8); };
  for (size_t c = 0; c < kSkinChannels; ++c) {
    for (size_t k = 0; k < kPeopleShares.size(); ++k) add(s.quantiles[c][k] - kMeasuredReflectance[c][k], 0.025);
    add(s.darkest[c] - kMeasuredDarkest[c], 0.05);
    add(s.log_correlation[c] - kMeasuredLogCorrelation[c], 0.02);
  }
  add(s.scattering_sd / s.scattering_mean - kMeasuredScatteringSpread, 0.03);
  return cost;
}

Population FitPopulation(const SkinTable& table, const Population& start, int count, uint64_t seed,
                         const std::function<void(int round, double cost)>& progress) {
  constexpr int kMostRounds = 400;
  constexpr double kFirstStep = 0.1, kSmall = 1e-3;
  const auto corner = [&](const Point& at) {
    return Corner{at, PeopleCost(Summarise(DrawPeople(table, 0, count, seed, PopulationAt(at, start))))};
  };
  std::array<Corner, kFitted + 1> simplex;
  simplex.fill(corner(PointOf(start)));
  for (size_t k = 0; k < kFitted; ++k) {
    Point at = simplex[0].at;
    at[k] += kFirstStep;
    simplex[k + 1] = corner(at);
  }
  for (int round = 0; round < kMostRounds; ++round) {
    std::sort(simplex.begin(), simplex.end(), [](const Corner& a, const Corner& b) { return a.cost < b.cost; });
    progress(round, simplex.front().cost);
    double size = 0.0;
    for (size_t k = 0; k < kFitted; ++k) size = std::max(size, std::abs(simplex.back().at[k] - simplex.front().at[k]));
    if (size < kSmall) break;
    Point middle{};  // of all but the worst
    for (size_t i = 0; i < kFitted; ++i)
      for (size_t k = 0; k < kFitted; ++k) middle[k] += simplex[i].at[k] / kFitted;
    Corner& worst = simplex.back();
    const Corner reflected = corner(Along(worst.at, middle, 2.0));
    if (reflected.cost < simplex.front().cost) {
      const Corner further = corner(Along(worst.at, middle, 3.0));
      worst = further.cost < reflected.cost ? further : reflected;
    } else if (reflected.cost < simplex[kFitted - 1].cost) {
      worst = reflected;
    } else {
      const Corner nearer = corner(Along(worst.at, middle, reflected.cost < worst.cost ? 1.5 : 0.5));
      if (nearer.cost < std::min(worst.cost, reflected.cost)) {
        worst = nearer;
      } else {
        for (size_t i = 1; i <= kFitted; ++i) simplex[i] = corner(Along(simplex[0].at, simplex[i].at, 0.5));
      }
    }
  }
  const auto best = std::min_element(simplex.begin(), simplex.end(),
                                     [](const Corner& a, const Corner& b) { return a.cost < b.cost; });
  return PopulationAt(best->at, start);
}

}  // namespace stratalux::rig
