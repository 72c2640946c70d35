// SPDX-License-Identifier: Apache-2.0
// Profiles that stand apart, as hair and eyes do among skin: they are fitted as the others are, and have no part in
// what all share.
#include <algorithm>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/mean_layers.h"
#include "fitter/mixture/sampled_lights.h"
#include "tests/fitter/mixture/em_cases.h"

namespace stratalux::fit {
namespace {

constexpr int kMixedProfiles = 48;

bool StandsApart(int64_t profile) { return profile % 3 == 1; }

// Of every third one a light is five times as strong: no law of skin explains it.
EmCases Cases() {
  EmCases made = MakeEmCases({.profiles = kMixedProfiles}, {}, 11);
  for (SrdBatch& batch : made.batches)
    for (int64_t i = 0; i < kMixedProfiles; ++i)
      for (float& y : batch.Samples(i))
        if (StandsApart(i) && &batch == &made.batches[0]) y *= 5.0F;
  return made;
}

EmCases Marked() {
  EmCases made = Cases();
  for (SrdBatch& batch : made.batches)
    for (int64_t i = 0; i < kMixedProfiles; ++i) batch.apart.push_back(StandsApart(i) ? 1 : 0);
  return made;
}

// Without them.
EmCases Alone() {
  const EmCases all = Cases();
  std::vector<int64_t> which;
  for (int64_t i = 0; i < kMixedProfiles; ++i)
    if (!StandsApart(i)) which.push_back(i);
  EmCases alone;
  for (const SrdBatch& batch : all.batches) alone.batches.push_back(ProfilesOf(batch, which));
  return alone;
}

TEST(ProfilesApart, HaveNoPartInTau) {
  const double marked = EstimateTau(Marked().lights(), 1.4), alone = EstimateTau(Alone().lights(), 1.4),
               all = EstimateTau(Cases().lights(), 1.4);
  EXPECT_DOUBLE_EQ(marked, alone);
  EXPECT_GT(std::abs(marked - all), 0.01);
}

TEST(ProfilesApart, HaveNoPartInTheMeanLayers) {
  const EmCases marked = Marked(), alone = Alone(), cases = Cases();
  const auto mean = [](const EmCases& of) {
    const auto layers = MeanLayers(of.lights(), 1, EmOptions{});
    EXPECT_TRUE(layers.ok()) << layers.status().message();
    return layers->at(0).weight;
  };
  const auto weight = mean(marked), weight_alone = mean(alone), weight_of_all = mean(cases);
  ASSERT_EQ(weight.size(), weight_alone.size());
  double worst = 0.0;
  for (size_t l = 0; l < weight.size(); ++l) {
    EXPECT_NEAR(weight[l], weight_alone[l], 1e-5) << l;
    worst = std::max(worst, std::abs(weight[l] - weight_of_all[l]));
  }
  EXPECT_GT(worst, 1e-3);
}

TEST(ProfilesApart, AreFittedAsTheOthersAre) {
  const EmCases marked = Marked(), cases = Cases();
  const std::vector<int> projectors = {0, 1, 2};
  const auto fit = FitMixture(marked.lights(), projectors, kMixedProfiles, 1, 1, {}),
             of_all = FitMixture(cases.lights(), projectors, kMixedProfiles, 1, 1, {});
  ASSERT_TRUE(fit.ok() && of_all.ok());
  EXPECT_EQ(fit->weight, of_all->weight);
  for (int64_t i = 0; i < kMixedProfiles; ++i) EXPECT_TRUE(fit->Fitted(i)) << i;
}

TEST(ProfilesApart, AreInNoSample) {
  const EmCases marked = Marked();
  EXPECT_EQ(SampledPixels(marked.batches[0], 1, 1).profiles(), 2 * kMixedProfiles / 3);
  EXPECT_EQ(SampledPixels(Cases().batches[0], 1, 1).profiles(), kMixedProfiles);
  const int64_t which[] = {3, 4};
  const SrdBatch part = ProfilesOf(marked.batches[0], which);
  EXPECT_TRUE(part.Shares(0));
  EXPECT_TRUE(part.IsApart(1) && !part.Shares(1));
}

}  // namespace
}  // namespace stratalux::fit
