// SPDX-License-Identifier: Apache-2.0
// The normal texture of an exported mesh, shaded as glTF 2.0 says: it gives the photometric normal back.
#include "fitter/export/normal_texture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include <gmock/gmock.h>

#include "fitter/stages/mesh_normals.h"
#include "fitter/stages/surface_export.h"
#include "shared/image/png.h"
#include "tests/fitter/export/read_export.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr int kBumpyWidth = 60, kBumpyHeight = 50;

// A bulge 600 mm before the camera, whose light tells of bumps of up to 20 degrees along x and y; of the left third it
// tells nothing.
ExportedSurface Bumpy() {
  ExportedSurface bumpy;
  SurfaceMap& s = bumpy.surface;
  s.point_mm = s.normal = Image<float>(kBumpyWidth, kBumpyHeight, 3);
  s.depth_sigma_mm = Image<float>(kBumpyWidth, kBumpyHeight, 1, 0.05F);
  s.mask = Image<uint8_t>(kBumpyWidth, kBumpyHeight, 1, 1);
  bumpy.own_normal = Image<float>(kBumpyWidth, kBumpyHeight, 3);
  for (int j = 0; j < kBumpyHeight; ++j)
    for (int i = 0; i < kBumpyWidth; ++i) {
      const double x = i - 25.0, y = j - 20.0;
      const Eigen::Vector3f at(static_cast<float>(x), static_cast<float>(y),
                               static_cast<float>(600.0 + (x * x + 0.5 * y * y) / 80.0));
      const Eigen::Vector3f own = Eigen::Vector3d(x / 40.0, y / 80.0, -1.0).normalized().cast<float>();
      const Eigen::Vector3f fine =
          (own.cast<double>() + Eigen::Vector3d(0.35 * std::sin(0.9 * i), 0.35 * std::cos(0.7 * j), 0.0))
              .normalized()
              .cast<float>();
      for (int c = 0; c < 3; ++c) {
        s.point_mm(i, j, c) = at[c];
        bumpy.own_normal(i, j, c) = own[c];
        s.normal(i, j, c) = i < kBumpyWidth / 3 ? own[c] : fine[c];
      }
    }
  return bumpy;
}

class NormalTextureFile : public ScratchFolderTest {
 protected:
  void SetUp() override {
    ASSERT_TRUE(WriteSurface(folder_, bumpy_, {ExportFormat::kGlb}, [](const std::string&) {}).ok());
    glb_ = ReadGlb(folder_ / "mesh.glb");
    texture_ = Texture(glb_.normal_png);
  }
  [[nodiscard]] Image<uint16_t> Texture(const std::string& png) const {
    WriteText(folder_ / "normals.png", png);
    int bits = 0;
    auto texture = ReadPng(folder_ / "normals.png", &bits);
    EXPECT_TRUE(texture.ok()) << texture.status().message();
    EXPECT_EQ(bits, 8);
    EXPECT_EQ(texture->channels(), 3);
    return std::move(*texture);
  }
  static Eigen::Vector3d VectorOf(const std::array<float, 3>& v) { return {v[0], v[1], v[2]}; }
  // The worst angle to the photometric normal, degrees, turned as glTF has it: x, -y, -z.
  [[nodiscard]] double WorstAngle_deg(const GlbRead& glb, const Image<uint16_t>& texture) const {
    return WorstAngle_deg(glb, texture, bumpy_.surface);
  }
  static double WorstAngle_deg(const GlbRead& glb, const Image<uint16_t>& texture, const SurfaceMap& surface) {
    double worst_rad = 0.0;
    for (size_t v = 0; v < glb.positions.size(); ++v) {
      const int i = static_cast<int>(v) % kBumpyWidth, j = static_cast<int>(v) / kBumpyWidth;
      const Eigen::Vector3d n = surface.Normal(i, j), expected(n.x(), -n.y(), -n.z());
      worst_rad = std::max(worst_rad, std::acos(std::clamp(expected.dot(ShadedNormal(glb, texture, v)), -1.0, 1.0)));
    }
    return worst_rad * 180.0 / std::numbers::pi;
  }

  const ExportedSurface bumpy_ = Bumpy();
  GlbRead glb_;
  Image<uint16_t> texture_;
};

TEST_F(NormalTextureFile, GivesThePhotometricNormalBackWithinItsBits) {
  EXPECT_THAT(FaultsOf(glb_), IsEmpty());
  const double worst_deg = WorstAngle_deg(glb_, texture_);
  std::printf("worst angle %.3f degrees\n", worst_deg);
  EXPECT_LE(worst_deg, 0.5);
}

TEST_F(NormalTextureFile, ItsCheckSeesAFlippedChannelAndAFlippedTangent) {
  for (const int channel : {0, 1}) {
    Image<uint16_t> flipped = texture_;
    for (int j = 0; j < kBumpyHeight; ++j)
      for (int i = 0; i < kBumpyWidth; ++i) flipped(i, j, channel) = 255 - texture_(i, j, channel);
    EXPECT_GT(WorstAngle_deg(glb_, flipped), 20.0) << channel;
  }
  GlbRead flipped = glb_;
  for (auto& t : flipped.tangents)
    for (int c = 0; c < 3; ++c) t[c] = -t[c];
  EXPECT_GT(WorstAngle_deg(flipped, texture_), 20.0);
  flipped = glb_;
  for (auto& t : flipped.tangents) t[3] = -t[3];
  EXPECT_GT(WorstAngle_deg(flipped, texture_), 20.0);
}

// Of viewers that make their own tangents: red leans along u, green up the picture, against v.
TEST_F(NormalTextureFile, HasTangentsAlongUAndBitangentsUpThePicture) {
  for (size_t v = 0; v < glb_.positions.size(); ++v) {
    const size_t i = v % kBumpyWidth, j = v / kBumpyWidth;
    if (i + 1 == kBumpyWidth || j == 0) continue;
    const auto& t = glb_.tangents[v];
    const Eigen::Vector3d tangent(t[0], t[1], t[2]), up = t[3] * VectorOf(glb_.normals[v]).cross(tangent);
    const Eigen::Vector3d along_u = VectorOf(glb_.positions[v + 1]) - VectorOf(glb_.positions[v]),
                          against_v = VectorOf(glb_.positions[v - kBumpyWidth]) - VectorOf(glb_.positions[v]);
    EXPECT_GT(tangent.dot(along_u.normalized()), 0.99) << v;
    EXPECT_GT(up.dot(against_v.normalized()), 0.95) << v;
  }
}

TEST_F(NormalTextureFile, IsFlatWhereLightTellsNothing) {
  for (int j = 0; j < kBumpyHeight; ++j)
    for (int i = 0; i < kBumpyWidth / 3; ++i) {
      ASSERT_EQ(texture_(i, j, 0), 128) << i << " " << j;
      ASSERT_EQ(texture_(i, j, 1), 128) << i << " " << j;
      ASSERT_EQ(texture_(i, j, 2), 255) << i << " " << j;
    }
}

TEST_F(NormalTextureFile, IsNotThereWithoutPhotometricNormals) {
  ExportedSurface bare = bumpy_;
  bare.own_normal = {};
  ASSERT_TRUE(WriteSurface(folder_, bare, {ExportFormat::kGlb}, [](const std::string&) {}).ok());
  const GlbRead glb = ReadGlb(folder_ / "mesh.glb");
  EXPECT_THAT(glb.normal_png, IsEmpty());
  EXPECT_THAT(glb.tangents, IsEmpty());
  EXPECT_FALSE(glb.json["materials"][0].contains("normalTexture"));
}

// A coat by the surface's normals on a base by those of light that scattered, of green light.
TEST_F(NormalTextureFile, GivesBothNormalsBackWhereBothAreKnown) {
  ExportedSurface both = bumpy_;
  both.coat = 0.7;
  both.roughness = 0.55;
  both.diffuse_normal = Image<float>(kBumpyWidth, kBumpyHeight, 9);
  SurfaceMap softer = bumpy_.surface;
  for (int j = 0; j < kBumpyHeight; ++j)
    for (int i = 0; i < kBumpyWidth; ++i) {
      const Eigen::Vector3d own(both.own_normal(i, j, 0), both.own_normal(i, j, 1), both.own_normal(i, j, 2));
      const Eigen::Vector3d half = (own + bumpy_.surface.Normal(i, j)).normalized();
      for (int k = 0; k < 3; ++k) {
        both.diffuse_normal(i, j, k) = both.own_normal(i, j, k);
        both.diffuse_normal(i, j, 3 + k) = softer.normal(i, j, k) = static_cast<float>(half[k]);
        both.diffuse_normal(i, j, 6 + k) = bumpy_.surface.normal(i, j, k);
      }
    }
  ASSERT_TRUE(WriteSurface(folder_, both, {ExportFormat::kGlb}, [](const std::string&) {}).ok());
  const GlbRead glb = ReadGlb(folder_ / "mesh.glb");
  EXPECT_THAT(FaultsOf(glb), IsEmpty());
  EXPECT_LE(WorstAngle_deg(glb, Texture(glb.normal_png), softer), 0.5);
  EXPECT_LE(WorstAngle_deg(glb, Texture(glb.coat_normal_png)), 0.5);
  EXPECT_GT(WorstAngle_deg(glb, Texture(glb.normal_png)), 5.0) << "they are not the same";
  const auto& extensions = glb.json["materials"][0]["extensions"];
  EXPECT_EQ(extensions["KHR_materials_clearcoat"]["clearcoatFactor"], 0.7);
  EXPECT_EQ(extensions["KHR_materials_clearcoat"]["clearcoatRoughnessFactor"], 0.55);
  EXPECT_EQ(extensions["KHR_materials_specular"]["specularFactor"], 0.0);
  EXPECT_EQ(glb.json["extensionsUsed"].size(), 2U);
  EXPECT_FALSE(glb.json.contains("extensionsRequired")) << "a viewer that knows neither shows the base";
}

// Two triangles of a unit square that faces +z, its picture upright, turned by a right angle, and mirrored.
Mesh Square(const std::vector<std::array<float, 2>>& uv) {
  Mesh mesh;
  mesh.positions_mm = {{0, 1, 0}, {0, 0, 0}, {1, 0, 0}, {1, 1, 0}};
  mesh.normals.assign(4, {0, 0, 1});
  mesh.texture_uv = uv;
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  return mesh;
}

TEST(TangentsOf, FollowTheTexture) {
  EXPECT_THAT(TangentsOf(Square({{0, 0}, {0, 1}, {1, 1}, {1, 0}})), Each(ElementsAre(1, 0, 0, 1)));
  EXPECT_THAT(TangentsOf(Square({{0, 1}, {1, 1}, {1, 0}, {0, 0}})), Each(ElementsAre(0, -1, 0, 1)));
  EXPECT_THAT(TangentsOf(Square({{1, 0}, {1, 1}, {0, 1}, {0, 0}})), Each(ElementsAre(-1, 0, 0, -1)));
}

// MikkTSpace's weights: of a vertex whose triangles have tangents x and y, at angles of 90 and 45 degrees.
TEST(TangentsOf, AreWeightedByTheAngleAtTheVertex) {
  Mesh mesh;
  mesh.positions_mm = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {-1, -1, 0}};
  mesh.normals.assign(5, {0, 0, 1});
  // u = x, v = -y of the first triangle, u = y, v = x of the second.
  mesh.texture_uv = {{0, 0}, {1, 0}, {0, -1}, {0, -1}, {-1, -1}};
  mesh.triangles = {{0, 1, 2}, {0, 3, 4}};
  const auto tangent = TangentsOf(mesh)[0];
  EXPECT_NEAR(std::atan2(tangent[1], tangent[0]), std::atan2(45.0, 90.0), 1e-6);
  EXPECT_EQ(tangent[3], 1.0F);
}

TEST(TangentsOf, AreAcrossTheNormalOfAVertexWithoutATriangle) {
  Mesh mesh = Square({{0, 0}, {0, 1}, {1, 1}, {1, 0}});
  mesh.positions_mm.push_back({5, 5, 0});
  mesh.normals.push_back({0.6F, 0, 0.8F});
  mesh.texture_uv.push_back({0.5F, 0.5F});
  const auto t = TangentsOf(mesh).back();
  EXPECT_NEAR(t[0] * t[0] + t[1] * t[1] + t[2] * t[2], 1.0, 1e-6);
  EXPECT_NEAR(0.6 * t[0] + 0.8 * t[2], 0.0, 1e-6);
}

// glTF's blue says the front half alone.
TEST(NormalTexture, IsFlatWhereTheFinerNormalPointsBehind) {
  Mesh mesh = Square({{0.25F, 0.25F}, {0.25F, 0.75F}, {0.75F, 0.75F}, {0.75F, 0.25F}});
  mesh.tangents = TangentsOf(mesh);
  const std::vector<std::array<float, 3>> finer = {{0.6F, 0, -0.8F}, {0.6F, 0, 0.8F}, {0, 0.6F, 0.8F}, {0, 0, 1}};
  const Image<uint8_t> texture = NormalTexture(mesh, finer, 2, 2);
  const auto texel = [&](int i, int j) {
    return std::array<int, 3>{texture(i, j, 0), texture(i, j, 1), texture(i, j, 2)};
  };
  EXPECT_THAT(texel(0, 0), ElementsAre(128, 128, 255));
  EXPECT_THAT(texel(0, 1), ElementsAre(204, 128, 230));
  EXPECT_THAT(texel(1, 1), ElementsAre(128, 204, 230));
  EXPECT_THAT(texel(1, 0), ElementsAre(128, 128, 255));
}

}  // namespace
}  // namespace stratalux::fit
