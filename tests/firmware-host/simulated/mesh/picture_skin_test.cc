// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/picture_skin.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/srgb.h"
#include "shared/base/random.h"
#include "shared/image/png.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

class PictureSkinTest : public ScratchFolderTest {
 protected:
  [[nodiscard]] std::array<double, 3> AlbedoOf(const SkinParameters& skin) const {
    return {albedo_(0, skin), albedo_(1, skin), albedo_(2, skin)};
  }
  SkinTable table_ = *SkinTable::Load(SkinTable::DefaultPath());
  SkinAlbedo albedo_{table_};
  SkinParameters like_{.epidermis_mm = 0.1F};
};

TEST_F(PictureSkinTest, FindsTheSkinThatMadeTheColour) {
  const SkinOfAlbedo solve(albedo_, like_);
  Random random(3);
  for (int k = 0; k < 400; ++k) {
    SkinParameters skin = like_;
    skin.melanin = static_cast<float>(0.0055 * std::pow(50.0, random.Uniform()));
    skin.blood = static_cast<float>(0.0006 * std::pow(90.0, random.Uniform()));
    const SolvedSkin solved = solve(AlbedoOf(skin));
    EXPECT_LT(solved.deviation, 1e-4) << skin.melanin << ", " << skin.blood;
    EXPECT_NEAR(solved.skin.melanin / skin.melanin, 1.0, 0.01) << skin.melanin << ", " << skin.blood;
    EXPECT_NEAR(solved.skin.blood / skin.blood, 1.0, 0.03) << skin.melanin << ", " << skin.blood;
    EXPECT_FALSE(solved.clamped);
    EXPECT_EQ(solved.skin.epidermis_mm, like_.epidermis_mm);
    EXPECT_EQ(solved.skin.scattering, like_.scattering);
  }
}

// Whatever the colour: no skin of a fine grid over the table's range comes nearer.
TEST_F(PictureSkinTest, NoOtherSkinIsNearerToAnyColour) {
  constexpr int kSide = 120;
  std::vector<Eigen::Vector3d> skins;
  for (int j = 0; j < kSide; ++j)
    for (int i = 0; i < kSide; ++i) {
      SkinParameters skin = like_;
      skin.melanin = static_cast<float>(0.005 * std::pow(60.0, i / (kSide - 1.0)));
      skin.blood = static_cast<float>(0.0005 * std::pow(120.0, j / (kSide - 1.0)));
      const auto a = AlbedoOf(skin);
      skins.emplace_back(std::log(a[0]), std::log(a[1]), std::log(a[2]));
    }
  const SkinOfAlbedo solve(albedo_, like_);
  Random random(4);
  int clamped = 0;
  for (int k = 0; k < 300; ++k) {
    const std::array<double, 3> colour = {random.Uniform(0.0, 1.2), random.Uniform(), random.Uniform()};
    const SolvedSkin solved = solve(colour);
    const Eigen::Vector3d wanted(std::log(std::max(colour[0], 1e-4)), std::log(std::max(colour[1], 1e-4)),
                                 std::log(std::max(colour[2], 1e-4)));
    double nearest = 1e300;
    for (const Eigen::Vector3d& skin : skins) nearest = std::min(nearest, (skin - wanted).norm() / std::sqrt(3.0));
    EXPECT_LE(solved.deviation, nearest + 1e-4) << colour[0] << ", " << colour[1] << ", " << colour[2];
    clamped += solved.clamped;
    EXPECT_GE(solved.skin.melanin, 0.00499F);
    EXPECT_LE(solved.skin.melanin, 0.3001F);
    EXPECT_GE(solved.skin.blood, 0.000499F);
    EXPECT_LE(solved.skin.blood, 0.0601F);
  }
  EXPECT_GT(clamped, 30) << "many colours are no skin's";
  EXPECT_GT(solve({0.1, 0.2, 0.9}).deviation, 0.5) << "blue";
  EXPECT_TRUE(solve({1.0, 1.0, 1.0}).clamped) << "white";
  EXPECT_TRUE(solve({0.0, 0.0, 0.0}).clamped) << "black";
}

TEST_F(PictureSkinTest, LaysThePictureOnTheRightWayUp) {
  // Light, dark; reddish, darker: upper row first, as pictures have them.
  Image<uint16_t> picture(2, 2, 3);
  constexpr int kColours[4][3] = {{210, 160, 140}, {120, 70, 50}, {190, 110, 100}, {90, 55, 40}};
  for (int k = 0; k < 4; ++k)
    for (int c = 0; c < 3; ++c) picture(k % 2, k / 2, c) = static_cast<uint16_t>(kColours[k][c]);
  const PictureSkin skin(picture, 8, 1.0, albedo_, like_);
  const SkinOfAlbedo solve(albedo_, like_);
  auto expected = [&](int k) {
    std::array<double, 3> linear;
    for (int c = 0; c < 3; ++c) linear[c] = LinearFromSrgb(kColours[k][c] / 255.0);
    return solve(linear).skin;
  };
  const Eigen::Vector2d middles[4] = {{0.25, 0.75}, {0.75, 0.75}, {0.25, 0.25}, {0.75, 0.25}};
  for (int k = 0; k < 4; ++k)
    for (const Eigen::Vector2d& turns : {Eigen::Vector2d(0, 0), Eigen::Vector2d(1, 0), Eigen::Vector2d(-3, 2)}) {
      const SkinParameters here = skin.At(middles[k] + turns);
      EXPECT_NEAR(here.melanin / expected(k).melanin, 1.0, 1e-5) << k;
      EXPECT_NEAR(here.blood / expected(k).blood, 1.0, 1e-5) << k;
      EXPECT_EQ(skin.TexelAt(middles[k] + turns).skin.melanin, expected(k).melanin);
    }
  const SkinParameters between = skin.At({0.5, 0.5});
  EXPECT_NEAR(between.melanin,
              (expected(0).melanin + expected(1).melanin + expected(2).melanin + expected(3).melanin) / 4.0, 1e-6);
}

TEST_F(PictureSkinTest, AScaleIsAnExposure) {
  // The linear light of 188 is half that of 255.
  const double half = LinearFromSrgb(188 / 255.0);
  EXPECT_NEAR(half, 0.503, 0.001);
  Image<uint16_t> dark(1, 1, 3), light(1, 1, 3);
  for (int c = 0; c < 3; ++c) {
    dark(0, 0, c) = static_cast<uint16_t>(std::array<int, 3>{143, 100, 83}[c]);
    light(0, 0, c) = static_cast<uint16_t>(std::array<int, 3>{143, 100, 83}[c] * 257);
  }
  const PictureSkin once(dark, 8, 1.0, albedo_, like_), twice(light, 16, 2.0, albedo_, like_);
  EXPECT_LT(twice.At({0, 0}).melanin, once.At({0, 0}).melanin);
  const auto a = AlbedoOf(once.At({0, 0})), b = AlbedoOf(twice.At({0, 0}));
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(b[c] / a[c], 2.0, 0.4) << c;
}

TEST_F(PictureSkinTest, RefusesWhatIsNoColourPng) {
  WriteText(folder_ / "albedo.jpg", "\xff\xd8\xff\xe0 JFIF");
  ASSERT_TRUE(WritePng8(folder_ / "grey.png", Image<uint8_t>(4, 4, 1, 90)).ok());
  const struct {
    const char *name, *complaint;
  } cases[] = {{"albedo.jpg", "not a PNG file; [mesh] albedo takes a PNG file (convert albedo.jpg albedo.png)"},
               {"grey.png", "a picture without colours"},
               {"nobody.png", "nobody.png"}};
  for (const auto& c : cases) {
    const auto picture = PictureSkin::Read(folder_ / c.name, 1.0, albedo_, like_);
    ASSERT_FALSE(picture.ok()) << c.name;
    EXPECT_EQ(picture.status().code(), StatusCode::kUsage) << c.name;
    EXPECT_THAT(picture.status().message(), HasSubstr(c.complaint)) << c.name;
    EXPECT_THAT(picture.status().message(), HasSubstr(c.name));
  }
}

}  // namespace
}  // namespace stratalux::rig
