// SPDX-License-Identifier: Apache-2.0
// The mean layers of a pixel's neighbours, and what a prior centred on them is worth.
#include "fitter/mixture/neighbour_layers.h"

#include <cmath>

#include <gtest/gtest.h>

#include "fitter/mixture/choose_prior.h"
#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/mean_layers.h"
#include "tests/fitter/mixture/em_cases.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 72, kHeight = 24, kLayers = 2;
constexpr double kSpacingMm = 0.5;
// The session's mean of both kinds.
const std::vector<LayerSet> kMean = {{{0.2, 0.2}, {0.3, 0.3}, {0.5, 2.0}, 0.0}};

// Two kinds of skin: on the left narrow and shallow, on the right wide and deep, `ratio` times as bright. Of each layer
// `noise` of its weight, depth and width.
MixtureMap TwoKinds(double ratio, double noise, uint64_t seed) {
  MixtureMap map;
  map.width = kWidth;
  map.height = kHeight;
  map.channels = 1;
  map.layers = kLayers;
  Random random(seed);
  for (int i = 0; i < kWidth * kHeight; ++i) {
    const bool right = i % kWidth >= kWidth / 2;
    for (int l = 0; l < kLayers; ++l) {
      const double share = (l == 0) == right ? 0.1 : 0.3;
      map.weight.push_back(static_cast<float>(share * (right ? ratio : 1.0) * (1.0 + noise * random.Normal())));
      map.depth_mm.push_back(static_cast<float>((right ? 0.6 : 0.2) * (1.0 + noise * random.Normal())));
      map.sigma_mm.push_back(static_cast<float>((l == 0 ? 0.5 : 2.0) * (1.0 + noise * random.Normal())));
    }
    map.reason.push_back(static_cast<uint8_t>(FitReason::kFitted));
  }
  return map;
}

double NarrowShare(const ProfileLayers& near, int64_t i) {
  const int64_t at = near.row[i] * kLayers;
  return near.weight[at] / (near.weight[at] + near.weight[at + 1]);
}

TEST(NeighbourLayers, AreThoseOfTheSkinAroundWithoutItsNoise) {
  const MixtureMap map = TwoKinds(1.0, 0.1, 31);
  const ProfileLayers near = NeighbourLayers(map, {}, kMean, kSpacingMm);
  double squares = 0.0, own = 0.0;
  for (int y = 0; y < kHeight; ++y)
    for (const int x : {0, 8, 16, kWidth - 17, kWidth - 9, kWidth - 1}) {  // away from the border of the kinds
      const int64_t i = y * kWidth + x;
      const bool right = x >= kWidth / 2;
      ASSERT_TRUE(near.Has(i));
      // A tenth of noise, by some ten neighbours of nearly its brightness and more; a twentieth of the session's.
      EXPECT_NEAR(NarrowShare(near, i), right ? 0.25 : 0.75, 0.06) << x << ' ' << y;
      EXPECT_NEAR(near.depth_mm[i * kLayers], right ? 0.6 : 0.2, right ? 0.09 : 0.04);
      EXPECT_NEAR(near.sigma_mm[i * kLayers + 1], 2.0, 0.25);
      squares += std::pow(NarrowShare(near, i) - (right ? 0.25 : 0.75), 2);
      own += std::pow(
          map.weight[i * kLayers] / (map.weight[i * kLayers] + map.weight[i * kLayers + 1]) - (right ? 0.25 : 0.75), 2);
    }
  EXPECT_LT(squares, own / 4.0);
}

TEST(NeighbourLayers, OfAnotherBrightnessDoNotCount) {
  // A lip beside a cheek: the border is as sharp as the brightness is.
  const ProfileLayers near = NeighbourLayers(TwoKinds(3.0, 0.0, 32), {}, kMean, kSpacingMm),
                      blind = NeighbourLayers(TwoKinds(1.0, 0.0, 32), {}, kMean, kSpacingMm);
  for (const int x : {kWidth / 2 - 1, kWidth / 2}) {
    const int64_t i = 8 * kWidth + x;
    const double own = x < kWidth / 2 ? 0.75 : 0.25;
    EXPECT_NEAR(NarrowShare(near, i), own, 0.03);  // the session's alone
    EXPECT_GT(std::abs(NarrowShare(blind, i) - own), 0.1);
  }
}

TEST(NeighbourLayers, WhatStandsApartNeitherGivesNorTakes) {
  MixtureMap map = TwoKinds(1.0, 0.0, 33);
  std::vector<uint8_t> apart(map.reason.size(), 0);
  const int64_t hair = 8 * kWidth + 3, hole = 8 * kWidth + 4;
  apart[hair] = 1;
  map.depth_mm[hair * kLayers] = 100.0F;
  map.reason[hole] = static_cast<uint8_t>(FitReason::kTooDark);
  map.depth_mm[hole * kLayers] = 100.0F;
  const ProfileLayers near = NeighbourLayers(map, apart, kMean, kSpacingMm);
  EXPECT_FALSE(near.Has(hair));
  EXPECT_FALSE(near.Has(hole));
  for (const float depth : near.depth_mm) EXPECT_LT(depth, 0.61F);
}

TEST(NeighbourLayers, WhoIsAloneHasTheSessions) {
  MixtureMap map = TwoKinds(1.0, 0.0, 34);
  for (size_t i = 1; i < map.reason.size(); ++i) map.reason[i] = static_cast<uint8_t>(FitReason::kNoProjector);
  const ProfileLayers near = NeighbourLayers(map, {}, kMean, kSpacingMm);
  EXPECT_NEAR(NarrowShare(near, 0), 0.5, 1e-6);  // itself it does not count
  EXPECT_NEAR(near.weight[0] + near.weight[1], map.weight[0] + map.weight[1], 1e-6);
  EXPECT_FALSE(near.Has(1));
}

TEST(NeighbourLayers, ColoursHaveTheirOwnAndThreadsChangeNothing) {
  const MixtureMap left = TwoKinds(1.0, 0.2, 36), right = TwoKinds(2.0, 0.2, 37);
  MixtureMap both = left;
  both.channels = 2;
  for (auto field : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm}) {
    (both.*field).clear();
    for (int64_t i = 0; i < left.profiles(); ++i)
      for (const MixtureMap* map : {&left, &right})
        for (int l = 0; l < kLayers; ++l) (both.*field).push_back((map->*field)[i * kLayers + l]);
  }
  both.reason.insert(both.reason.end(), both.reason.begin(), both.reason.end());
  const std::vector<LayerSet> means = {kMean[0], kMean[0]};
  setenv("STRATALUX_THREADS", "1", 1);
  const ProfileLayers one = NeighbourLayers(both, {}, means, kSpacingMm);
  setenv("STRATALUX_THREADS", "3", 1);
  const ProfileLayers three = NeighbourLayers(both, {}, means, kSpacingMm);
  unsetenv("STRATALUX_THREADS");
  EXPECT_EQ(one.weight, three.weight);
  EXPECT_EQ(one.depth_mm, three.depth_mm);
  EXPECT_EQ(one.sigma_mm, three.sigma_mm);
  const ProfileLayers of_left = NeighbourLayers(left, {}, kMean, kSpacingMm),
                      of_right = NeighbourLayers(right, {}, kMean, kSpacingMm);
  for (const int64_t i : {int64_t{0}, int64_t{700}, left.profiles() - 1}) {
    EXPECT_EQ(one.depth_mm[(2 * i) * kLayers], of_left.depth_mm[i * kLayers]);
    EXPECT_EQ(one.depth_mm[(2 * i + 1) * kLayers], of_right.depth_mm[i * kLayers]);
  }
}

TEST(StartLayers, AreTheNeighboursWhereThereAreAnyElseTheMean) {
  MixtureMap map = TwoKinds(1.0, 0.0, 35);
  map.reason[1] = static_cast<uint8_t>(FitReason::kNoProjector);
  const ProfileLayers near = NeighbourLayers(map, {}, kMean, kSpacingMm);
  std::vector<LayerSet> mean = kMean;
  mean[0].background = 0.08;
  const StartLayers start(mean, &near, 300.0);
  EXPECT_EQ(start.Of(0).weight[0], double{near.weight[0]});
  EXPECT_EQ(start.Of(0).sigma_mm[1], double{near.sigma_mm[1]});
  EXPECT_NEAR(start.Of(0).background, 0.08, 1e-6);  // a fifth of the light, as of the session's
  EXPECT_EQ(start.Photons(0, 3000.0), 3000.0);
  EXPECT_EQ(start.Of(1).weight, kMean[0].weight);
  EXPECT_EQ(start.Photons(1, 3000.0), 300.0);
  EXPECT_TRUE(StartLayers().Of(0).weight.empty());
  const ProfileLayers some = ProfilesOf(near, std::vector<int64_t>{5, 1});
  EXPECT_EQ(some.weight[1], near.weight[near.row[5] * kLayers + 1]);
  EXPECT_FALSE(some.Has(1));
}

// Two skins of 18 x 9 mm, side by side.
constexpr int kSide = 30;
constexpr double kPixelMm = 0.6;
constexpr int kOneIn = 13;  // profiles that are judged
const std::vector<int> kProjectors = {0, 1, 2};

// A cheek's and a lip's, whose light spreads three quarters as far.
EmCases TwoSkins(double unlike) {
  LayerSet cheek{{0.12, 0.1, 0.08, 0.06}, {0.08, 0.2, 0.5, 0.9}, {0.2, 0.5, 1.2, 2.4}}, lip = cheek;
  for (auto* values : {&lip.depth_mm, &lip.sigma_mm})
    for (double& v : *values) v *= 0.75;
  return MakeEmCases({.profiles = kSide * kSide,
                      .peak_counts = 1000.0,
                      .read_photons = 25.0,
                      .alike = kSide * kSide / 2,
                      .unlike = unlike,
                      .skins = {cheek, lip}},
                     {}, 51);
}

EmOptions WithPrior(double photons) {
  EmOptions options;
  options.prior.photons = photons;
  options.surface_term = false;  // these skins have none
  return options;
}

Result<NeighboursChoice> Choose(const EmCases& made, double photons, const std::vector<int>& projectors = kProjectors,
                                double spacing_mm = kPixelMm) {
  const EmOptions options = WithPrior(photons);
  SLX_ASSIGN_OR_RETURN(const LeftOutLights left, LeaveOutEach(made.lights(), projectors, 1, options));
  return ChooseNeighboursPrior(made.lights(), left, kSide, kSide, options, spacing_mm);
}

NeighboursChoice Chosen(const EmCases& made) {
  const auto choice = Choose(made, 300.0);
  EXPECT_TRUE(choice.ok()) << choice.status().message();
  EXPECT_EQ(choice->trials.size(), 4U);
  return *choice;
}

TEST(FitAmongNeighbours, KnowsSkinsOfFewPhotonsBetterThanTheSessionsMeanDoes) {
  const EmOptions options = WithPrior(300.0);
  const EmCases made = TwoSkins(0.03);
  const double photons = Chosen(made).photons;
  EXPECT_GT(photons, 300.0);
  const auto mean = MeanLayers(made.lights(), 1, options);
  ASSERT_TRUE(mean.ok());
  const auto session = FitMixture(made.lights(), kProjectors, kSide, kSide, 1, options, *mean);
  const auto among = [&](double spacing_mm) {
    return FitAmongNeighbours(made.lights(), kProjectors, kSide, kSide, 1, options, *mean, spacing_mm, photons);
  };
  const auto near = among(kPixelMm), far = among(10.0);  // where nobody is near
  ASSERT_TRUE(session.ok() && near.ok() && far.ok());
  const double of_near = ShapeError(made, *near, options, kOneIn);
  EXPECT_LT(of_near, 0.8 * ShapeError(made, *session, options, kOneIn));
  EXPECT_LT(of_near, 0.9 * ShapeError(made, *far, options, kOneIn));
  EXPECT_EQ(near->prior_photons, photons);
  EXPECT_EQ(near->session_photons, 300.0);
  EXPECT_EQ(session->session_photons, 0.0);
}

TEST(ChooseNeighboursPrior, BindsPixelsThatAreUnlikeTheirNeighboursLess) {
  const double unlike = Chosen(TwoSkins(0.4)).photons, alike = Chosen(TwoSkins(0.03)).photons;
  EXPECT_LE(3.0 * unlike, alike);
}

TEST(ChooseNeighboursPrior, AsksForNoMorePhotonsThanEmTakesAndIsTheSameForAnyNumberOfThreads) {
  const EmCases made = TwoSkins(0.03);
  const auto choose = [&] {
    const auto choice = Choose(made, 1e6);
    EXPECT_TRUE(choice.ok());
    return *choice;
  };
  setenv("STRATALUX_THREADS", "1", 1);
  const NeighboursChoice one = choose();
  setenv("STRATALUX_THREADS", "3", 1);
  const NeighboursChoice three = choose();
  unsetenv("STRATALUX_THREADS");
  ASSERT_EQ(one.trials.size(), 4U);
  EXPECT_EQ(one.trials[3].photons, kMostPriorPhotons);
  for (size_t t = 0; t < 4; ++t) EXPECT_EQ(one.trials[t].more_nats, three.trials[t].more_nats);
}

TEST(ChooseNeighboursPrior, TriesNothingWhereNothingCanBeTold) {
  const EmCases made = TwoSkins(0.03);
  const auto choose = [&](const std::vector<int>& projectors, double photons, double spacing_mm) {
    const auto choice = Choose(made, photons, projectors, spacing_mm);
    EXPECT_TRUE(choice.ok());
    return choice->photons == 0.0 && choice->trials.empty();
  };
  EXPECT_TRUE(choose({0, 0, 0}, 300.0, kPixelMm));  // no projector to leave out
  EXPECT_TRUE(choose(kProjectors, 0.0, kPixelMm));  // no prior is asked for
  EXPECT_TRUE(choose(kProjectors, 300.0, 0.0));     // nobody knows how far pixels are apart
}

TEST(FitAmongNeighbours, FitsWhatStandsApartByTheSessionsMean) {
  EmOptions options;
  options.prior.photons = 300.0;
  EmCases made = MakeEmCases({.profiles = 64, .peak_counts = 400.0, .alike = 64}, options, 53);
  for (SrdBatch& light : made.batches) {
    light.apart.assign(64, 0);
    light.apart[9] = 1;
  }
  const auto mean = MeanLayers(made.lights(), 1, options);
  ASSERT_TRUE(mean.ok());
  int64_t told = 0;
  const auto near = FitAmongNeighbours(made.lights(), {0, 1, 2}, 8, 8, 1, options, *mean, 1.0, 3000.0,
                                       [&](int64_t done) { told += done; });
  const auto first = FitMixture(made.lights(), {0, 1, 2}, 8, 8, 1, options, *mean);
  ASSERT_TRUE(near.ok() && first.ok());
  EXPECT_EQ(told, 64 + 64);
  EXPECT_EQ(LayersOf(*near, 9).weight, LayersOf(*first, 9).weight);
  EXPECT_NE(LayersOf(*near, 10).weight, LayersOf(*first, 10).weight);
}

}  // namespace
}  // namespace stratalux::fit
