// SPDX-License-Identifier: Apache-2.0
// The skin stage: what it says where no light was separated, and its files.
#include <algorithm>
#include <cmath>
#include <fstream>

#include <gmock/gmock.h>

#include "fitter/export/exr_file.h"
#include "fitter/stages/skin.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;

class SkinStage : public ScratchFolderTest {
 protected:
  static SkinMask Mask() {
    Image<uint8_t> surface(9, 7, 1, 1);
    surface(0, 0) = 0;
    SkinMask mask = AllSkin(surface);
    mask.told = true;
    mask.colour = 2;
    mask.log_reflectance = {-1.25, 0.5};
    mask.share = {0.75, 0.2};
    mask.skin(3, 3) = 0;
    mask.probability(3, 3) = 0.125F;
    --mask.skin_quads;
    return mask;
  }
};

TEST_F(SkinStage, WithoutSeparatedLightAllOfTheSurfaceIsSkinAndThatIsSaid) {
  FaceShape shape;
  shape.surface.mask = Image<uint8_t>(9, 7, 1, 1);
  const auto mask = JudgeFaceSkin(shape, {}, shape.record, 16.0);
  ASSERT_TRUE(mask.ok());
  EXPECT_FALSE(mask->told);
  EXPECT_EQ(mask->skin_quads, 63);
  EXPECT_THAT(Describe(*mask), HasSubstr("all 63 quads of the surface count as skin"));
}

TEST_F(SkinStage, SaysHowManyQuadsAreLeftOut) {
  EXPECT_THAT(Describe(Mask()), HasSubstr("61 of 62 quads of the surface are skin; 1 "));
}

TEST_F(SkinStage, ReadsWhatItWrote) {
  const SkinMask mask = Mask();
  ASSERT_TRUE(SaveSkin(folder_, mask).ok());
  const auto back = LoadSkin(folder_);
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->told, mask.told);
  EXPECT_EQ(back->skin_quads, mask.skin_quads);
  EXPECT_EQ(back->counts, mask.counts);
  EXPECT_EQ(back->colour, mask.colour);
  EXPECT_EQ(back->log_reflectance.centre, mask.log_reflectance.centre);
  EXPECT_EQ(back->share.scale, mask.share.scale);
  for (int j = 0; j < mask.skin.height(); ++j)
    for (int i = 0; i < mask.skin.width(); ++i) {
      EXPECT_EQ(back->skin(i, j), mask.skin(i, j));
      EXPECT_EQ(back->reason(i, j), mask.reason(i, j));
      EXPECT_TRUE(back->probability(i, j) == mask.probability(i, j) ||
                  (std::isnan(back->probability(i, j)) && std::isnan(mask.probability(i, j))));
    }
}

// SRDs of 4 x 3 pixels of 2 x 2 quads, two colours, two lights; nothing in them but which are valid.
SrdSet Srds() {
  SrdSet srds{2, 4, 3, 2, std::vector<SrdBatch>(2), {}};
  for (SrdBatch& batch : srds.batches) {
    batch.first_u_mm.assign(24, 0.0F);
    batch.valid.assign(24, 1);
  }
  return srds;
}

TEST_F(SkinStage, PixelsOfLittleSkinHaveNoPartInWhatAllShare) {
  SkinMask mask = AllSkin(Image<uint8_t>(9, 7, 1, 1));
  for (const auto& [i, j] : {std::pair(2, 0), {3, 0}, {2, 1}, {4, 2}, {5, 2}}) mask.skin(i, j) = 0;
  SrdSet srds = Srds();
  ASSERT_TRUE(SetApart(srds, mask).ok());
  for (const SrdBatch& batch : srds.batches)
    for (int64_t i = 0; i < 24; ++i)
      EXPECT_EQ(batch.IsApart(i), i / 2 == 1) << i;  // three quads of four; of the other pixel it is half
}

TEST_F(SkinStage, WhereNoPixelIsSkinNoneIsApart) {
  SkinMask mask = AllSkin(Image<uint8_t>(9, 7, 1, 1));
  std::ranges::fill(mask.skin.pixels(), uint8_t{0});
  SrdSet srds = Srds();
  ASSERT_TRUE(SetApart(srds, mask).ok());
  EXPECT_TRUE(srds.batches[0].Shares(0));
  srds.width = 5;
  EXPECT_EQ(SetApart(srds, mask).code(), StatusCode::kUsage);
}

TEST_F(SkinStage, RefusesFilesThatAreNotItsOwn) {
  EXPECT_FALSE(LoadSkin(folder_).ok());
  ASSERT_TRUE(SaveSkin(folder_, Mask()).ok());
  Image<float> map(9, 7, 3, 7.0F);  // no reason has that number
  ASSERT_TRUE(WriteExr(folder_ / "skin.exr", map, {"probability", "skin", "reason"}).ok());
  EXPECT_EQ(LoadSkin(folder_).status().code(), StatusCode::kIntegrity);
  ASSERT_TRUE(SaveSkin(folder_, Mask()).ok());
  std::ofstream(folder_ / "skin.json") << "{\"told\": 3}";
  EXPECT_EQ(LoadSkin(folder_).status().code(), StatusCode::kIntegrity);
}

}  // namespace
}  // namespace stratalux::fit
