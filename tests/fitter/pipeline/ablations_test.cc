// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/ablations.h"

#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

SrdSet FourLights() {
  SrdSet set;
  for (int p = 0; p < 4; ++p) {
    SrdBatch b;
    b.samples = 8;
    for (int i = 0; i < 16; ++i) b.y.push_back(static_cast<float>(100 * p + i));
    b.first_u_mm.assign(2, 0.0F);
    b.valid.assign(2, 1);
    for (auto* v : {&b.slope_in, &b.slope_in_across, &b.cos_in}) v->assign(2, static_cast<float>(p));
    set.batches.push_back(std::move(b));
  }
  return set;
}

TEST(Ablations, SpoilTheTrainingLightsOnly) {
  const SrdSet before = FourLights();
  {
    const SrdSet set = WithPermutedProjectors(before, 1);
    EXPECT_EQ(set.batches[1].slope_in, before.batches[1].slope_in);
    for (int p : {0, 2, 3}) EXPECT_NE(set.batches[p].slope_in, before.batches[p].slope_in);
    for (int p : {0, 2, 3}) EXPECT_EQ(set.batches[p].slope_in, set.batches[p].cos_in);  // all of a light together
    EXPECT_EQ(set.batches[0].y, before.batches[0].y);
  }
  {
    const SrdSet set = WithShuffledCombFrames(before, 7);
    for (int p = 0; p < 4; ++p) {
      EXPECT_NE(set.batches[p].y, before.batches[p].y);
      EXPECT_TRUE(
          std::is_permutation(set.batches[p].y.begin(), set.batches[p].y.begin() + 8, before.batches[p].y.begin()));
    }
  }
}

// A light that does not reach a profile has no direction there: given to another it would take that one away.
TEST(Ablations, DirectionsAreExchangedAmongLightsThatReachTheProfile) {
  SrdSet before = FourLights();
  before.batches[2].valid[1] = 0;
  before.batches[2].cos_in[1] = 0.0F;
  const SrdSet set = WithPermutedProjectors(before, 1);
  EXPECT_EQ(set.batches[0].cos_in[1], 3.0F);
  EXPECT_EQ(set.batches[3].cos_in[1], 0.0F);
  EXPECT_EQ(set.batches[2].cos_in[1], 0.0F);
  std::vector<float> all;
  for (const int p : {0, 2, 3}) all.push_back(set.batches[p].cos_in[0]);
  EXPECT_EQ(all, (std::vector<float>{2.0F, 3.0F, 0.0F}));
}

}  // namespace
}  // namespace stratalux::fit
