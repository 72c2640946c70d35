// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/srd_file.h"

#include <array>
#include <filesystem>

#include <gtest/gtest.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

class SrdFile : public ScratchFolderTest {};

// Three profiles of two samples, the middle one not valid; no white frames.
ExtractedSrds SmallSrds() {
  SrdBatch batch;
  batch.samples = 2;
  batch.pool = 2;
  batch.valid = {1, 0, 1};
  batch.y = {1.0F, 2.0F, 99.0F, 99.0F, 5.0F, 6.0F};
  for (auto* v :
       {&batch.noise_floor, &batch.noise_slope, &batch.first_u_mm, &batch.step_mm, &batch.line_width_mm, &batch.blur_mm,
        &batch.quad_x_mm, &batch.quad_y_mm, &batch.pair_mm, &batch.box_x_mm, &batch.box_y_mm, &batch.slope_in,
        &batch.slope_out, &batch.cos_in, &batch.cos_out, &batch.slope_in_across, &batch.slope_out_across})
    *v = {0.25F, 99.0F, 0.75F};
  ExtractedSrds srds;
  srds.set = {2, 3, 1, 1, {batch}, {}, 0.6};
  srds.figures.push_back({0, "columns", {{"valid", 2}, {"unlit", 1}}, 1, 2, 0.99, 0.02});
  return srds;
}

TEST_F(SrdFile, KeepsTheValidProfilesAsTheyAre) {
  const ExtractedSrds srds = SmallSrds();
  const SrdBatch& batch = srds.set.batches[0];
  ASSERT_TRUE(SaveSrds(folder_, srds).ok());
  const auto read = LoadSrds(folder_);
  ASSERT_TRUE(read.ok()) << read.status().message();
  ASSERT_EQ(read->set.batches.size(), 1U);
  EXPECT_TRUE(read->set.row_batches.empty());
  EXPECT_EQ(read->set.pool, 2);
  EXPECT_EQ(read->set.width, 3);
  EXPECT_EQ(read->set.spacing_mm, 0.6);
  const SrdBatch& back = read->set.batches[0];
  EXPECT_EQ(back.valid, batch.valid);
  EXPECT_EQ(back.row, (std::vector<int32_t>{0, -1, 1}));
  EXPECT_EQ(back.y, (std::vector<float>{1.0F, 2.0F, 5.0F, 6.0F}));
  EXPECT_EQ(back.noise_floor, (std::vector<float>{0.25F, 0.0F, 0.75F}));
  EXPECT_EQ(back.noise_slope, back.noise_floor);
  EXPECT_EQ(back.slope_out_across, (std::vector<float>{0.25F, 0.0F, 0.75F}));
  EXPECT_TRUE(back.white.empty());
  EXPECT_EQ(back.pool, 2);
  EXPECT_TRUE(back.wrapped);
  ASSERT_EQ(read->figures.size(), 1U);
  EXPECT_EQ(read->figures[0].profiles_by_reason.at("unlit"), 1);
  EXPECT_EQ(read->figures[0].energy_median, 0.99);
}

TEST_F(SrdFile, AProfileByItselfIsThatOfAll) {
  ASSERT_TRUE(SaveSrds(folder_, SmallSrds()).ok());
  const auto all = LoadSrds(folder_);
  ASSERT_TRUE(all.ok()) << all.status().message();
  for (const int64_t profile : {0, 1, 2}) {
    const auto read = LoadProfileSrds(folder_, profile);
    ASSERT_TRUE(read.ok()) << read.status().message();
    ASSERT_EQ(read->batches.size(), 1U);
    ASSERT_EQ(read->figures.size(), 1U);
    EXPECT_EQ(read->figures[0].missing_frames, all->figures[0].missing_frames);
    const SrdBatch expected = ProfilesOf(all->set.batches[0], std::array{profile}), &one = read->batches[0];
    EXPECT_EQ(one.samples, expected.samples);
    EXPECT_EQ(one.pool, expected.pool);
    EXPECT_EQ(one.wrapped, expected.wrapped);
    EXPECT_EQ(one.valid, expected.valid);
    EXPECT_EQ(one.row, expected.row);
    for (const auto field :
         {&SrdBatch::y, &SrdBatch::noise_floor, &SrdBatch::noise_slope, &SrdBatch::white, &SrdBatch::first_u_mm,
          &SrdBatch::step_mm, &SrdBatch::cos_out, &SrdBatch::slope_out_across})
      EXPECT_EQ(one.*field, expected.*field) << profile;
  }
  const auto none = LoadProfileSrds(folder_, -1);
  ASSERT_TRUE(none.ok());
  EXPECT_TRUE(none->batches.empty());
}

TEST_F(SrdFile, AnArrayThatIsMissingIsNamed) {
  for (const char* name : {"noise_floor.npy", "noise_slope.npy", "cos_in.npy"}) {
    std::filesystem::remove_all(folder_ / "columns_0");
    ASSERT_TRUE(SaveSrds(folder_, SmallSrds()).ok());
    std::filesystem::remove(folder_ / "columns_0" / name);
    for (const Status& status : {LoadSrds(folder_).status(), LoadProfileSrds(folder_, 2).status()}) {
      EXPECT_EQ(status.code(), StatusCode::kIntegrity) << name;
      EXPECT_NE(status.message().find(name), std::string::npos) << status.message();
    }
  }
}

TEST_F(SrdFile, AnArrayThatIsCutShortIsNamed) {
  ASSERT_TRUE(SaveSrds(folder_, SmallSrds()).ok());
  const auto samples = folder_ / "columns_0" / "y.npy";
  std::filesystem::resize_file(samples, std::filesystem::file_size(samples) - 4);
  for (const Status& status : {LoadSrds(folder_).status(), LoadProfileSrds(folder_, 2).status()}) {
    EXPECT_EQ(status.code(), StatusCode::kIntegrity);
    EXPECT_NE(status.message().find(samples.string()), std::string::npos) << status.message();
  }
}

}  // namespace
}  // namespace stratalux::fit
