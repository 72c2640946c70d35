// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/srd_samples.h"

#include <array>

#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

// Sample k of profile i is 10 i + k.
SrdBatch Numbered(int profiles) {
  SrdBatch batch;
  batch.samples = 3;
  batch.first_u_mm.assign(static_cast<size_t>(profiles), 0.0F);
  batch.valid.assign(static_cast<size_t>(profiles), 1);
  for (int i = 0; i < profiles; ++i)
    for (int k = 0; k < 3; ++k) {
      batch.y.push_back(static_cast<float>(10 * i + k));
      batch.variance.push_back(static_cast<float>(10 * i + k) + 0.5F);
    }
  return batch;
}

void ExpectNumbered(const SrdBatch& batch, int64_t profile, float number) {
  EXPECT_EQ(batch.Samples(profile)[2], 10.0F * number + 2.0F) << profile;
  EXPECT_EQ(batch.Variances(profile)[0], 10.0F * number + 0.5F) << profile;
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
  EXPECT_EQ(batch.variance.size(), 6U);
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
}

TEST(SrdBatchDeathTest, ARowThatIsNotThereIsNotReadAsAnother) {
  SrdBatch batch = Numbered(2);
  batch.valid = {0, 1};
  batch.KeepValidRows();
  EXPECT_DEATH((void)batch.Samples(0), "at >= 0");
}

}  // namespace
}  // namespace stratalux::fit
