// SPDX-License-Identifier: Apache-2.0
// The diffuse normals of a face: what smoothing and the layers do to a wave together is what the skin does to it.
#include <Eigen/Core>
#include <cmath>

#include <gtest/gtest.h>

#include "fitter/stages/diffuse_normals.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

constexpr int kAcross = 160, kDown = 100;
constexpr double kBlurredMm = 1.2, kQuadMm = 0.5;

// A plane 700 mm away, and normals of a wave of 1 / kBlurredMm along x, of which smoothing has left exp(-1/2).
FaceShape WavyFace(Image<float>& normal) {
  FaceShape face;
  face.record.camera.cfa = Cfa::kMono;
  face.record.camera.model = {.width = kAcross, .height = kDown, .fx = 1400, .fy = 1400, .cx = 79.5, .cy = 49.5};
  SurfaceMap& s = face.surface;
  s = {Image<float>(kAcross, kDown, 3), Image<float>(kAcross, kDown, 3), Image<float>(kAcross, kDown),
       Image<uint8_t>(kAcross, kDown, 1, 1)};
  s.smoothing_quads = Image<float>(kAcross, kDown, 1, static_cast<float>(kBlurredMm / kQuadMm));
  normal = Image<float>(kAcross, kDown, 3);
  for (int j = 0; j < kDown; ++j)
    for (int i = 0; i < kAcross; ++i) {
      const double x = (i - 79.5) * kQuadMm;
      const Eigen::Vector3d n = Eigen::Vector3d(0.05 * std::cos(x / kBlurredMm), 0.0, -1.0).normalized();
      s.point_mm(i, j, 0) = static_cast<float>(x);
      s.point_mm(i, j, 1) = static_cast<float>((j - 49.5) * kQuadMm);
      s.point_mm(i, j, 2) = 700.0F;
      s.normal(i, j, 2) = -1.0F;
      for (int k = 0; k < 3; ++k) normal(i, j, k) = static_cast<float>(n[k]);
    }
  return face;
}

// Half of the light in each of two layers, a profile for pool x pool quads.
FittedLayers TwoLayers(float narrow_mm, float wide_mm, int pool) {
  FittedLayers layers;
  layers.pool = pool;
  MixtureMap& map = layers.map;
  map.width = kAcross / pool;
  map.height = kDown / pool;
  map.channels = 1;
  map.layers = 2;
  for (int64_t p = 0; p < map.profiles(); ++p) {
    map.weight.insert(map.weight.end(), {0.2F, 0.2F});
    map.sigma_mm.insert(map.sigma_mm.end(), {narrow_mm, wide_mm});
  }
  map.reason.assign(static_cast<size_t>(map.profiles()), static_cast<uint8_t>(FitReason::kFitted));
  return layers;
}

// Of the wave's amplitude, how much is left; NaN where normals have another form.
double Left(const Image<float>& before, const Image<float>& after) {
  double product = 0.0, squares = 0.0;
  for (int j = 40; j < kDown - 40; ++j)
    for (int i = 40; i < kAcross - 40; ++i) {
      product += double(before(i, j, 0)) * after(i, j, 0);
      squares += double(before(i, j, 0)) * before(i, j, 0);
    }
  return product / squares;
}

// exp(-sigma^2 k^2 / 2) at k = 1 / kBlurredMm.
double SkinLeaves(double sigma_mm) { return std::exp(-0.5 * std::pow(sigma_mm / kBlurredMm, 2)); }

TEST(FilterNormals, MakeTheBlurOfTheFinestWaveTheSkins) {
  Image<float> normal;
  const FaceShape face = WavyFace(normal);
  for (const int pool : {1, 2})
    for (const auto& [narrow_mm, wide_mm] : {std::pair(0.3F, 3.0F), std::pair(0.8F, 2.0F), std::pair(1.5F, 2.0F)}) {
      const auto diffuse = FilterNormals(face, normal, TwoLayers(narrow_mm, wide_mm, pool));
      ASSERT_TRUE(diffuse.ok());
      const double skin = 0.5 * (SkinLeaves(narrow_mm) + SkinLeaves(wide_mm));
      EXPECT_NEAR(std::exp(-0.5) * Left(normal, *diffuse), skin, 0.02) << narrow_mm << ", " << wide_mm << " mm";
    }
}

TEST(FilterNormals, LeaveASurfaceThatSmoothingBlursMoreThanTheSkinDoes) {
  Image<float> normal;
  const FaceShape face = WavyFace(normal);
  const auto diffuse = FilterNormals(face, normal, TwoLayers(0.3F, 1.4F, 1));
  ASSERT_TRUE(diffuse.ok());
  EXPECT_NEAR(Left(normal, *diffuse), 1.0, 1e-6);
}

// As those of the truth, and of older programs.
TEST(FilterNormals, FilterByTheLayersAloneWhereNoSmoothingIsKnown) {
  Image<float> normal;
  FaceShape face = WavyFace(normal);
  face.surface.smoothing_quads = {};
  const auto diffuse = FilterNormals(face, normal, TwoLayers(0.8F, 2.0F, 1));
  ASSERT_TRUE(diffuse.ok());
  EXPECT_NEAR(Left(normal, *diffuse), 0.5 * (SkinLeaves(0.8) + SkinLeaves(2.0)), 0.02);
}

TEST(FilterNormals, KeepTheSurfacesWhereNothingWasFitted) {
  Image<float> normal;
  const FaceShape face = WavyFace(normal);
  FittedLayers layers = TwoLayers(0.8F, 2.0F, 1);
  const int64_t profile = layers.map.ProfileIndex(80, 50, 0);
  layers.map.reason[profile] = static_cast<uint8_t>(FitReason::kTooDark);
  layers.map.weight[2 * profile] = layers.map.sigma_mm[2 * profile] = std::nanf("");
  const auto diffuse = FilterNormals(face, normal, layers);
  ASSERT_TRUE(diffuse.ok());
  for (int k = 0; k < 3; ++k) EXPECT_EQ((*diffuse)(80, 50, k), normal(80, 50, k));
  EXPECT_NE((*diffuse)(81, 50, 0), normal(81, 50, 0));
}

class DiffuseNormalFile : public ScratchFolderTest {};

TEST_F(DiffuseNormalFile, GivesBackWhatWasSaved) {
  Image<float> diffuse(4, 3, 9, 0.5F);
  diffuse(1, 1, 5) = -0.25F;
  ASSERT_TRUE(SaveDiffuseNormals(folder_, diffuse).ok());
  const auto read = LoadDiffuseNormals(folder_, 3);
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(std::vector(read->pixels().begin(), read->pixels().end()),
            std::vector(diffuse.pixels().begin(), diffuse.pixels().end()));
  EXPECT_EQ(OneDiffuseNormal(*read)(1, 1, 2), -0.25F) << "green";
  EXPECT_EQ(LoadDiffuseNormals(folder_ / "none", 3).status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace stratalux::fit
