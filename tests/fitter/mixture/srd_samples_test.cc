// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/srd_samples.h"

#include <algorithm>
#include <array>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/mixture/photon_noise.h"

namespace stratalux::fit {
namespace {

// Sample k of profile i is 10 i + k.
SrdBatch Numbered(int profiles) {
  SrdBatch batch;
  batch.samples = 3;
  batch.first_u_mm.assign(static_cast<size_t>(profiles), 0.0F);
  batch.valid.assign(static_cast<size_t>(profiles), 1);
  for (int i = 0; i < profiles; ++i) {
    for (int k = 0; k < 3; ++k) batch.y.push_back(static_cast<float>(10 * i + k));
    batch.noise_floor.push_back(static_cast<float>(i) + 0.5F);
    batch.noise_slope.push_back(static_cast<float>(i) + 0.25F);
  }
  return batch;
}

void ExpectNumbered(const SrdBatch& batch, int64_t profile, float number) {
  EXPECT_EQ(batch.Samples(profile)[2], 10.0F * number + 2.0F) << profile;
  EXPECT_EQ(batch.noise_floor[profile], number + 0.5F) << profile;
  EXPECT_EQ(batch.noise_slope[profile], number + 0.25F) << profile;
}

TEST(SrdBatch, KeepsTheRowsOfValidProfilesAlone) {
  SrdBatch batch = Numbered(5);
  batch.valid = {0, 1, 0, 1, 1};
  batch.KeepValidRows();
  EXPECT_EQ(batch.y.size(), 9U);
  EXPECT_EQ(batch.row, (std::vector<int32_t>{-1, 0, -1, 1, 2}));
  for (const int i : {1, 3, 4}) ExpectNumbered(batch, i, static_cast<float>(i));
  batch.valid[3] = 0;  // and again, of rows that were dropped before
  batch.KeepValidRows();
  EXPECT_EQ(batch.y.size(), 6U);
  for (const int i : {1, 4}) ExpectNumbered(batch, i, static_cast<float>(i));
}

TEST(SrdBatch, APartOfItHasItsProfilesRows) {
  SrdBatch batch = Numbered(4);
  batch.valid = {1, 0, 1, 1};
  batch.KeepValidRows();
  constexpr std::array<int64_t, 3> kWhich = {3, 1, 0};
  const SrdBatch part = ProfilesOf(batch, kWhich);
  EXPECT_EQ(part.profiles(), 3);
  EXPECT_EQ(part.valid, (std::vector<uint8_t>{1, 0, 1}));
  ExpectNumbered(part, 0, 3.0F);
  ExpectNumbered(part, 2, 0.0F);
  EXPECT_EQ(part.row[1], -1);
  // Of the whole they keep their places, and so do some of them.
  EXPECT_EQ(batch.PlaceOf(2), 2);
  EXPECT_EQ(part.PlaceOf(0), 3);
  EXPECT_EQ(ProfilesOf(part, std::array<int64_t, 2>{2, 0}).place, (std::vector<int64_t>{0, 3}));
}

TEST(NoiseLine, IsTheCamerasLawWhicheverSampleComesFirst) {
  // var(y) = 0.02 + 0.5 y, as a camera of that read noise and gain has it.
  std::vector<float> samples = {0.3F, 0.04F, 2.0F, 0.9F, 0.0F};
  for (size_t turn = 0; turn < samples.size(); ++turn) {
    NoiseLine line;
    for (const float y : samples) line.Add(y, 0.02F + 0.5F * y);
    EXPECT_NEAR(line.Slope(), 0.5, 1e-6);
    EXPECT_NEAR(line.Floor(), 0.02, 1e-6);
    std::ranges::rotate(samples, samples.begin() + 1);
  }
}

// Below black there is no light, and no more noise than at it: a dim sample's sign must not tilt the line.
TEST(NoiseLine, OfASampleBelowZeroIsThatOfNoLight) {
  NoiseLine line;
  for (const float y : {-0.3F, 0.5F, 2.0F}) line.Add(y, 0.02F + 0.5F * std::max(y, 0.0F));
  EXPECT_NEAR(line.Slope(), 0.5, 1e-6);
  EXPECT_NEAR(line.Floor(), 0.02, 1e-6);
}

TEST(NoiseLine, KnowsNoSlopeWhereNoiseDoesNotRise) {
  NoiseLine none, constant, falling;
  EXPECT_EQ(none.Floor(), 0.0F);
  EXPECT_EQ(none.Slope(), 0.0F);
  for (const float y : {1.0F, 2.0F, 0.5F}) {
    constant.Add(y, 0.25F);
    falling.Add(y, 3.0F - y);
  }
  EXPECT_EQ(constant.Slope(), 0.0F);
  EXPECT_EQ(constant.Floor(), 0.25F);
  EXPECT_EQ(falling.Slope(), 0.0F);
  EXPECT_EQ(falling.Floor(), 1.75F);  // between the least, 1, and the most, 2.5
  SrdBatch batch = Numbered(1);
  batch.noise_slope = {0.0F};
  EXPECT_EQ(PhotonNoiseOf(batch, 0).counts, 1.0);
  EXPECT_EQ(PhotonNoiseOf(batch, 0).read_shift, 0.0);
}

TEST(SrdBatch, NoiseOfASumIsThatOfItsSamples) {
  SrdBatch batch = Numbered(2);
  batch.y[3] = -5.0F;  // of profile 1, whose others are 11 and 12
  EXPECT_NEAR(batch.VarianceOfSum(1), 3 * 1.5 + 1.25 * (11.0 + 12.0), 1e-9);
  const PhotonNoise noise = PhotonNoiseOf(batch, 1);
  EXPECT_NEAR(noise.counts, 1.0 / 1.25, 1e-12);
  EXPECT_NEAR(noise.read_shift, 1.5 / 1.25, 1e-12);
}

TEST(SrdBatchDeathTest, ARowThatIsNotThereIsNotReadAsAnother) {
  SrdBatch batch = Numbered(2);
  batch.valid = {0, 1};
  batch.KeepValidRows();
  EXPECT_DEATH((void)batch.Samples(0), "at >= 0");
}

}  // namespace
}  // namespace stratalux::fit
