// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/gloss_field.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

constexpr ProfileGrid kGrid = {.width = 60, .height = 50, .channels = 3, .spacing_mm = 1.0};

int64_t ProfileAt(int x, int y, int channel) { return (int64_t{y} * kGrid.width + x) * kGrid.channels + channel; }

// What each profile of the map says, `gloss(x, y)` and noise; of one pixel in `one_in`.
template <typename Gloss>
std::vector<GlossWitness> WitnessesOf(const Gloss& gloss, double noise, int one_in = 1) {
  Random random(3);
  std::vector<GlossWitness> witnesses;
  for (int y = 0; y < kGrid.height; ++y)
    for (int x = 0; x < kGrid.width; ++x)
      for (int c = 0; c < kGrid.channels; ++c) {
        const double effect = random.Uniform(2.0, 6.0), residual = effect * gloss(x, y) + noise * random.Normal();
        if ((y * kGrid.width + x) % one_in == 0)
          witnesses.push_back({ProfileAt(x, y, c), residual * effect, effect * effect});
      }
  return witnesses;
}

GlossField Solved(const std::vector<GlossWitness>& witnesses) {
  GlossField field = FlatGloss(kGrid);
  SolveGloss(witnesses, field);
  return field;
}

double Bump(int x, int y) { return 0.8 * std::exp(-(std::pow(x - 36, 2) + std::pow(y - 24, 2)) / (2.0 * 12.0 * 12.0)); }

TEST(GlossField, IsLinearBetweenItsNodesAndNothingWhereItHasNone) {
  GlossField field = FlatGloss(kGrid);
  ASSERT_EQ(field.cell_px, 12);
  ASSERT_EQ(field.columns, 6);
  ASSERT_EQ(field.nodes.size(), 36U);
  field.nodes[2 * 6 + 3] = 1.0;  // at pixel (36, 24)
  for (int c = 0; c < 3; ++c) EXPECT_EQ(field.At(ProfileAt(36, 24, c)), 1.0);
  EXPECT_NEAR(field.At(ProfileAt(42, 24, 0)), 0.5, 1e-12);
  EXPECT_NEAR(field.At(ProfileAt(42, 30, 0)), 0.25, 1e-12);
  EXPECT_EQ(field.At(ProfileAt(48, 24, 0)), 0.0);
  EXPECT_EQ(field.At(ProfileAt(59, 49, 2)), 0.0) << "the map's last profile";
  EXPECT_EQ(GlossField{}.At(12345), 0.0);
}

TEST(FlatGloss, HasNoNodesWhereNobodyKnowsTheSpacing) {
  EXPECT_TRUE(FlatGloss({60, 50, 3, 0.0}).nodes.empty());
  EXPECT_TRUE(FlatGloss({60, 50, 3, std::nan("")}).nodes.empty());
  EXPECT_TRUE(FlatGloss({.channels = 3}).nodes.empty());
  GlossField none = FlatGloss({.channels = 3});
  SolveGloss(WitnessesOf(Bump, 0.0), none);
  EXPECT_EQ(none.At(0), 0.0);
  EXPECT_EQ(FlatGloss({60, 50, 3, 1e-9}).nodes.size(), 4U) << "one cell holds all";
}

TEST(SolveGloss, FindsWhereSkinIsGlossier) {
  const GlossField found = Solved(WitnessesOf(Bump, 0.3));
  double square = 0.0, truth = 0.0;
  for (int y = 0; y < kGrid.height; ++y)
    for (int x = 0; x < kGrid.width; ++x) {
      square += std::pow(found.At(ProfileAt(x, y, 0)) - Bump(x, y), 2);
      truth += std::pow(Bump(x, y), 2);
    }
  EXPECT_LT(std::sqrt(square / truth), 0.2);
}

// Sebum takes nothing from what dry skin mirrors, and noise is no gloss.
TEST(SolveGloss, IsNowhereBelowNothing) {
  const GlossField dimmer = Solved(WitnessesOf([](int x, int y) { return -Bump(x, y); }, 0.3));
  EXPECT_GE(std::ranges::min(dimmer.nodes), 0.0);
  EXPECT_LT(std::ranges::max(dimmer.nodes), 0.02);
  EXPECT_LT(std::ranges::max(Solved(WitnessesOf([](int, int) { return 0.0; }, 1.0)).nodes), 0.02);
}

// Profiles of a cell err alike: seven times as many know no more, and one alone is heard once.
TEST(SolveGloss, HearsACellNotItsProfiles) {
  const auto weak = [](int one_in) {
    std::vector<GlossWitness> witnesses = WitnessesOf(Bump, 0.0, one_in);
    for (GlossWitness& w : witnesses) {
      w.along *= 0.1;
      w.square *= 0.1;
    }
    return Solved(witnesses).At(ProfileAt(36, 24, 0));
  };
  const double all = weak(1), some = weak(7);
  EXPECT_GT(all, 0.05);
  EXPECT_LT(all, 0.6) << "of 0.8: they are weak";
  EXPECT_NEAR(some, all, 0.1 * all);
  const auto lone = [](double square) {
    return Solved({{ProfileAt(36, 24, 0), square, square}}).At(ProfileAt(36, 24, 0));
  };
  EXPECT_EQ(lone(2.0), 0.0) << "less than dry skin asks";
  EXPECT_GT(lone(2000.0), 0.5);
  EXPECT_LT(lone(2000.0), 1.0);
}

// What SolveGloss makes least, in plain words.
double CostOf(const std::vector<GlossWitness>& witnesses, const GlossField& field) {
  constexpr double kDryRate = 2.0, kTogetherness = 5.0, kMostOfACell = 10.0;
  const size_t nodes = field.nodes.size(), columns = static_cast<size_t>(field.columns);
  GlossField one = field;
  std::vector<std::vector<double>> shares(witnesses.size(), std::vector<double>(nodes));
  std::vector<double> around(nodes, 0.0);
  for (size_t k = 0; k < nodes; ++k) {
    std::ranges::fill(one.nodes, 0.0);
    one.nodes[k] = 1.0;
    for (size_t i = 0; i < witnesses.size(); ++i) around[k] += shares[i][k] = one.At(witnesses[i].profile);
  }
  double cost = 0.0;
  for (size_t i = 0; i < witnesses.size(); ++i) {
    const double near = std::inner_product(shares[i].begin(), shares[i].end(), around.begin(), 0.0),
                 gloss = field.At(witnesses[i].profile);
    cost +=
        std::min(1.0, kMostOfACell / near) * (0.5 * witnesses[i].square * gloss * gloss - witnesses[i].along * gloss);
  }
  const auto apart = [&](size_t a, size_t b) { return std::pow(field.nodes[a] - field.nodes[b], 2); };
  for (size_t k = 0; k < nodes; ++k) {
    cost += kDryRate * field.nodes[k];
    if ((k + 1) % columns != 0) cost += 0.5 * kTogetherness * apart(k, k + 1);
    if (k + columns < nodes) cost += 0.5 * kTogetherness * apart(k, k + columns);
  }
  return cost;
}

TEST(SolveGloss, IsTheLeastOfItsCost) {
  const auto witnesses = WitnessesOf([](int x, int y) { return 2.0 * Bump(x, y) - 0.5; }, 2.0, 50);
  const GlossField least = Solved(witnesses);
  const auto kept = std::ranges::count_if(least.nodes, [](double gloss) { return gloss > 0.0; });
  EXPECT_GT(kept, 0);
  EXPECT_LT(kept, std::ssize(least.nodes));
  const double cost = CostOf(witnesses, least);
  for (size_t k = 0; k < least.nodes.size(); ++k)
    for (const double step : {-1e-3, 1e-3}) {
      GlossField other = least;
      other.nodes[k] += step;
      if (other.nodes[k] < 0.0) continue;
      EXPECT_GT(CostOf(witnesses, other), cost) << k << " " << step;
    }
}

}  // namespace
}  // namespace stratalux::fit
