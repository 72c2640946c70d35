// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cmath>

#include <gmock/gmock.h>

#include "fitter/export/exr_file.h"
#include "fitter/export/glb_file.h"
#include "fitter/export/ply_file.h"
#include "fitter/export/tiff_maps.h"
#include "fitter/reconstruction/mesh.h"
#include "fitter/reconstruction/point_cloud.h"
#include "fitter/stages/surface_export.h"
#include "shared/geometry/quad.h"
#include "shared/image/png.h"
#include "tests/fitter/export/read_export.h"
#include "tests/support/png_rgba.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int kWidth = 60, kHeight = 40;

CameraCalibration Camera() {
  CameraCalibration camera;
  camera.model = {.width = 2 * kWidth, .height = 2 * kHeight, .fx = 900.0, .fy = 960.0, .cx = 59.5, .cy = 39.5};
  return camera;
}

bool IsSkin(int i, int j) { return (i + 2 * j) % 5 != 0; }

// A ball of 35 mm radius, its front 600 mm away, with a hole and a step of 30 mm.
ExportedSurface Ball() {
  const Eigen::Vector3d centre(5.0, -8.0, 635.0);
  ExportedSurface ball;
  ball.camera = Camera();
  SurfaceMap& s = ball.surface;
  s.point_mm = s.normal = Image<float>(kWidth, kHeight, 3, std::nanf(""));
  s.depth_sigma_mm = Image<float>(kWidth, kHeight, 1, std::nanf(""));
  ball.normal_sigma_rad = s.depth_sigma_mm;
  s.mask = Image<uint8_t>(kWidth, kHeight);
  ball.skin = Image<uint8_t>(kWidth, kHeight, 1, 1);  // more than the surface, as no stage gives it
  ball.skin_told = true;
  ball.albedo = Image<float>(kWidth, kHeight, 3, std::nanf(""));
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth; ++i) {
      const Eigen::Vector3d ray = ball.camera.model.Unproject(QuadCentre(ball.camera.cfa, i, j));
      const double b = ray.dot(centre), c = centre.squaredNorm() - 35.0 * 35.0;
      if (b * b - c < 300.0 || (i >= 30 && i < 34 && j >= 10 && j < 15)) continue;
      const Eigen::Vector3d at = (b - std::sqrt(b * b - c)) * ray, n = (at - centre).normalized();
      const Eigen::Vector3d x = j < 28 ? at : Eigen::Vector3d(at * (1.0 + 30.0 / at.norm()));
      s.mask(i, j) = 1;
      ball.skin(i, j) = IsSkin(i, j) ? 1 : 0;
      s.depth_sigma_mm(i, j) = 0.02F + 0.001F * static_cast<float>(i);
      ball.normal_sigma_rad(i, j) = i < 20 ? std::nanf("") : 0.01F;
      for (int k = 0; k < 3; ++k) {
        s.point_mm(i, j, k) = static_cast<float>(x[k]);
        s.normal(i, j, k) = static_cast<float>(n[k]);
        if (i % 7 != 0) ball.albedo(i, j, k) = 0.2F + 0.1F * static_cast<float>(k) + 0.005F * static_cast<float>(i);
      }
    }
  ball.roughness = 0.5;
  ball.origin = {"s000001-0a1b2c3d", "0123456789abcdef", "from four projectors"};
  return ball;
}

class ExportFiles : public ScratchFolderTest {
 protected:
  void SetUp() override {
    const std::set<ExportFormat> all = ParseExportFormats(ExportFormatNames());
    const auto made = WriteSurface(folder_, ball_, all, [](const std::string&) {});
    ASSERT_TRUE(made.ok()) << made.status().message();
    report_ = *made;
    for (const std::string& name : SurfaceFiles(all)) EXPECT_TRUE(std::filesystem::exists(folder_ / name)) << name;
  }
  [[nodiscard]] const SurfaceMap& surface() const { return ball_.surface; }
  // Known quads, row by row.
  template <typename See>
  void EachQuad(const See& see) const {
    size_t v = 0;
    for (int j = 0; j < kHeight; ++j)
      for (int i = 0; i < kWidth; ++i)
        if (surface().mask(i, j) != 0) see(v++, i, j);
    EXPECT_EQ(v, static_cast<size_t>(report_.points));
  }
  [[nodiscard]] GlbRead Written(const Mesh& mesh) const {
    EXPECT_TRUE(WriteGlb(folder_ / "planted.glb", mesh, {}).ok());
    return ReadGlb(folder_ / "planted.glb");
  }

  const ExportedSurface ball_ = Ball();
  SurfaceExportReport report_;
};

TEST_F(ExportFiles, MeshPlyIsTheSurfaceInMillimetres) {
  const PlyRead ply = ReadPly(folder_ / "mesh.ply");
  EXPECT_THAT(ply.properties, ElementsAre("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"));
  EXPECT_THAT(ply.comments, Contains("session s000001-0a1b2c3d"));
  EXPECT_THAT(ply.comments, Contains("fit 0123456789abcdef"));
  EachQuad([&](size_t v, int i, int j) {
    for (int k = 0; k < 3; ++k) {
      EXPECT_EQ(ply.columns.at(ply.properties[k])[v], surface().point_mm(i, j, k));
      EXPECT_EQ(ply.columns.at(ply.properties[3 + k])[v], surface().normal(i, j, k));
    }
  });
  EXPECT_EQ(ply.faces.size(), static_cast<size_t>(report_.triangles));
}

// The hole is 4 x 5 quads, the step 30 mm: no edge is longer than what neighbours on the ball are apart.
TEST_F(ExportFiles, NoTriangleBridgesAHoleOrAStep) {
  const PlyRead ply = ReadPly(folder_ / "mesh.ply");
  const auto at = [&](int32_t v) {
    return Eigen::Vector3d(ply.columns.at("x")[v], ply.columns.at("y")[v], ply.columns.at("z")[v]);
  };
  for (const auto& f : ply.faces)
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d a = at(f[k]), b = at(f[(k + 1) % 3]);
      EXPECT_LE((a - b).norm(), 10.0);
      EXPECT_LT(std::abs(a.norm() - b.norm()), 20.0);
    }
}

TEST_F(ExportFiles, GltfIsTheMeshInMetresWithYUp) {
  const GlbRead glb = ReadGlb(folder_ / "mesh.glb");
  const PlyRead ply = ReadPly(folder_ / "mesh.ply");
  EXPECT_THAT(FaultsOf(glb), IsEmpty());
  ASSERT_EQ(glb.positions.size(), static_cast<size_t>(report_.points));
  ASSERT_EQ(glb.triangles.size(), ply.faces.size());
  EachQuad([&](size_t v, int i, int j) {
    const double turned[3] = {1.0, -1.0, -1.0};
    for (int k = 0; k < 3; ++k) {
      EXPECT_FLOAT_EQ(glb.positions[v][k], static_cast<float>(turned[k] * surface().point_mm(i, j, k) / 1000.0));
      EXPECT_FLOAT_EQ(glb.normals[v][k], static_cast<float>(turned[k] * surface().normal(i, j, k)));
    }
    EXPECT_FLOAT_EQ(glb.uv[v][0], (static_cast<float>(i) + 0.5F) / kWidth);
    EXPECT_FLOAT_EQ(glb.uv[v][1], (static_cast<float>(j) + 0.5F) / kHeight);
  });
  for (size_t t = 0; t < glb.triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) EXPECT_EQ(glb.triangles[t][k], static_cast<uint32_t>(ply.faces[t][k]));
  const auto& extras = glb.json.at("asset").at("extras");
  EXPECT_EQ(extras.at("session"), "s000001-0a1b2c3d");
  EXPECT_EQ(extras.at("length_unit"), "m");
  EXPECT_THAT(glb.json.at("asset").at("generator").get<std::string>(), HasSubstr("Stratalux"));
  EXPECT_EQ(glb.json.at("materials")[0].at("pbrMetallicRoughness").at("roughnessFactor"), 0.5);
}

TEST_F(ExportFiles, PlantedFaultsAreFound) {
  Mesh mesh = MeshFromSurface(surface());
  EXPECT_THAT(FaultsOf(Written(mesh)), IsEmpty());
  Mesh flipped = mesh;
  const auto corner = static_cast<size_t>(mesh.triangles[100][0]);
  for (float& n : flipped.normals[corner]) n = -n;
  EXPECT_THAT(FaultsOf(Written(flipped)), Contains(HasSubstr("point into their triangles")));
  Mesh metres = mesh;
  for (auto& p : metres.positions_mm)
    for (float& x : p) x *= 1e-3F;
  EXPECT_THAT(FaultsOf(Written(metres)), Contains("size"));
  Mesh micrometres = mesh;
  for (auto& p : micrometres.positions_mm)
    for (float& x : p) x *= 1e3F;
  EXPECT_THAT(FaultsOf(Written(micrometres)), Contains("size"));
  Mesh longer = mesh;
  for (float& n : longer.normals[7]) n *= 1.01F;
  EXPECT_THAT(FaultsOf(Written(longer)), Contains("1 normals are no unit vectors"));
  Mesh turned = mesh;
  std::swap(turned.triangles[5][0], turned.triangles[5][1]);
  EXPECT_THAT(FaultsOf(Written(turned)), Contains("3 normals point into their triangles"));
  mesh.triangles.clear();
  EXPECT_EQ(WriteGlb(folder_ / "empty.glb", mesh, {}).code(), StatusCode::kNotFound);
  EXPECT_FALSE(std::filesystem::exists(folder_ / "empty.glb"));
}

TEST_F(ExportFiles, TextureHoldsTheAlbedoWhereTheVertexLies) {
  const GlbRead glb = ReadGlb(folder_ / "mesh.glb");
  WriteText(folder_ / "texture.png", glb.png);
  int bits = 0;
  const auto texture = ReadPng(folder_ / "texture.png", &bits);
  ASSERT_TRUE(texture.ok()) << texture.status().message();
  const PlyRead ply = ReadPly(folder_ / "mesh.ply");
  int64_t filled = 0;
  EachQuad([&](size_t v, int i, int j) {
    const int x = static_cast<int>(glb.uv[v][0] * kWidth), y = static_cast<int>(glb.uv[v][1] * kHeight);
    const int from = i % 7 != 0 ? i : i + 1;  // its neighbour's where it was not fitted
    filled += i % 7 == 0 ? 1 : 0;
    for (int k = 0; k < 3; ++k) {
      const double code = (*texture)(x, y, k) / 255.0;
      const double linear = code <= 0.04045 ? code / 12.92 : std::pow((code + 0.055) / 1.055, 2.4);
      const double at_from = 0.2 + 0.1 * k + 0.005 * from, at_other = at_from - (i % 7 != 0 ? 0.0 : 0.01);
      EXPECT_LT(std::min(std::abs(linear - at_from), std::abs(linear - at_other)), 0.004) << i << " " << j;
      EXPECT_EQ(ply.columns.at(ply.properties[6 + k])[v], (*texture)(x, y, k));
    }
  });
  EXPECT_EQ(report_.without_albedo, filled);
}

// r^T C r is the depth's variance; across the ray C is that of a square of a quad's side.
TEST_F(ExportFiles, CloudsCovarianceIsPositiveDefiniteAndHoldsTheDepthsDeviation) {
  const PlyRead cloud = ReadPly(folder_ / "cloud.ply");
  ASSERT_THAT(cloud.properties, ElementsAre("x", "y", "z", "nx", "ny", "nz", "normal_sigma_rad", "cov_xx", "cov_xy",
                                            "cov_xz", "cov_yy", "cov_yz", "cov_zz", "red", "green", "blue", "skin"));
  const auto& c = cloud.columns;
  EachQuad([&](size_t v, int i, int j) {
    Eigen::Matrix3d covariance;
    covariance << c.at("cov_xx")[v], c.at("cov_xy")[v], c.at("cov_xz")[v], c.at("cov_xy")[v], c.at("cov_yy")[v],
        c.at("cov_yz")[v], c.at("cov_xz")[v], c.at("cov_yz")[v], c.at("cov_zz")[v];
    const Eigen::Vector3d x = surface().Point(i, j), ray = x.normalized();
    EXPECT_EQ(c.at("z")[v], x.z());
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solved(covariance);
    EXPECT_GT(solved.eigenvalues()[0], 0.0);
    const double sigma = surface().depth_sigma_mm(i, j);
    EXPECT_NEAR(std::sqrt(ray.dot(covariance * ray)), sigma, 1e-3 * sigma);
    const double side = 2.0 * x.z() / std::sqrt(900.0 * 960.0);
    const Eigen::Vector3d across = ray.unitOrthogonal();
    EXPECT_NEAR(across.dot(covariance * across), side * side / 12.0, 1e-3 * side * side);
    EXPECT_EQ(std::isnan(c.at("normal_sigma_rad")[v]), i < 20);
  });
}

TEST_F(ExportFiles, TiffHoldsWhatTheFloatsHold) {
  const auto depth = ReadExr(folder_ / "depth.exr", {"Z"});
  const auto normal = ReadExr(folder_ / "normal.exr", {"X", "Y", "Z"});
  ASSERT_TRUE(depth.ok() && normal.ok());
  const TiffRead depths = ReadTiff(folder_ / "depth.tif"), normals = ReadTiff(folder_ / "normal.tif");
  ASSERT_EQ(depths.samples.size(), depth->size());
  ASSERT_EQ(normals.samples.size(), normal->size());
  EXPECT_EQ(depths.channels, 1);
  EXPECT_EQ(normals.channels, 3);
  const double scale = depths.description.at("scale"), offset = depths.description.at("offset");
  EXPECT_EQ(depths.description.at("unit"), "mm");
  EXPECT_EQ(depths.description.at("session"), "s000001-0a1b2c3d");
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth; ++i) {
      const size_t q = static_cast<size_t>(j) * kWidth + i;
      const bool known = surface().mask(i, j) != 0;
      EXPECT_EQ(depths.samples[q] != 0, known);
      EXPECT_EQ(std::isfinite((*depth)(i, j)), known);
      if (!known) continue;
      EXPECT_EQ((*depth)(i, j), surface().point_mm(i, j, 2));
      EXPECT_NEAR(offset + scale * depths.samples[q], (*depth)(i, j), 0.00501);
      for (int k = 0; k < 3; ++k)
        EXPECT_NEAR(2.0 * normals.samples[3 * q + k] / 65535.0 - 1.0, (*normal)(i, j, k), 1.6e-5);
    }
}

TEST_F(ExportFiles, SkinIsInCloudTiffAndExr) {
  const PlyRead cloud = ReadPly(folder_ / "cloud.ply");
  const auto map = ReadExr(folder_ / "skin.exr", {"skin"});
  ASSERT_TRUE(map.ok()) << map.status().message();
  const TiffRead tiff = ReadTiff(folder_ / "skin.tif");
  ASSERT_EQ(tiff.samples.size(), map->size());
  EXPECT_EQ(tiff.channels, 1);
  const double scale = tiff.description.at("scale"), offset = tiff.description.at("offset");
  int64_t skin = 0;
  EachQuad([&](size_t v, int i, int j) {
    const float expected = IsSkin(i, j) ? 1.0F : 0.0F;
    skin += IsSkin(i, j) ? 1 : 0;
    EXPECT_EQ(cloud.columns.at("skin")[v], expected);
    EXPECT_EQ((*map)(i, j), expected);
    EXPECT_NEAR(offset + scale * tiff.samples[static_cast<size_t>(j) * kWidth + i], expected, 1e-12);
  });
  EXPECT_EQ(report_.skin, skin);
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth; ++i) {
      if (surface().mask(i, j) != 0) continue;
      EXPECT_TRUE(std::isnan((*map)(i, j)));
      EXPECT_EQ(tiff.samples[static_cast<size_t>(j) * kWidth + i], 0);
    }
}

// Not cut out by it: see GlbMaterial.
TEST_F(ExportFiles, TextureHasTheSurfaceAsItsAlpha) {
  const GlbRead glb = ReadGlb(folder_ / "mesh.glb");
  WriteText(folder_ / "texture.png", glb.png);
  const Image<uint8_t> texture = ReadPngRgba(folder_ / "texture.png");
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth; ++i) {
      EXPECT_EQ(texture(i, j, 3), surface().mask(i, j) != 0 ? 255 : 0) << i << " " << j;
      EXPECT_GT(texture(i, j, 0), 0) << "colour beside the surface, for filters";
    }
  EXPECT_FALSE(glb.json["materials"][0].contains("alphaMode")) << "opaque";
}

TEST_F(ExportFiles, DepthBeyondSixteenBitsIsMaskedAndCounted) {
  Image<float> depth_mm(4, 1, 1, std::nanf(""));
  depth_mm(0, 0) = 400.3F;
  depth_mm(1, 0) = 1054.3F;  // 399 + 655.3
  depth_mm(2, 0) = 1054.4F;
  const auto made = WriteDepthTiff(folder_ / "far.tif", depth_mm);
  ASSERT_TRUE(made.ok());
  EXPECT_EQ(made->offset_mm, 399.0);
  EXPECT_EQ(made->out_of_range, 1);
  EXPECT_THAT(ReadTiff(folder_ / "far.tif").samples, ElementsAre(130, 65530, 0, 0));
}

// Detail that tilts normals does not tear the mesh.
TEST_F(ExportFiles, TheMeshHangsTogetherAsTheSurfaceDoes) {
  ExportedSurface detailed = ball_;
  detailed.own_normal = ball_.surface.normal;
  EachQuad([&](size_t, int i, int j) {
    const Eigen::Vector3d tilted =
        (ball_.surface.Normal(i, j) + Eigen::Vector3d(i % 2 == 0 ? 1.5 : -1.5, 0, 0)).normalized();
    for (int k = 0; k < 3; ++k) detailed.surface.normal(i, j, k) = static_cast<float>(tilted[k]);
  });
  const auto before = ReadPly(folder_ / "mesh.ply");
  ASSERT_TRUE(
      WriteSurface(folder_, detailed, {ExportFormat::kPly, ExportFormat::kGlb}, [](const std::string&) {}).ok());
  const auto after = ReadPly(folder_ / "mesh.ply");
  EXPECT_EQ(after.faces, before.faces);
  EXPECT_THAT(FaultsOf(ReadGlb(folder_ / "mesh.glb")), IsEmpty()) << "a normal that points into the skin";
  size_t tilted = 0;
  EachQuad([&](size_t v, int i, int j) { tilted += after.columns.at("nx")[v] == detailed.surface.normal(i, j, 0); });
  EXPECT_GT(static_cast<double>(tilted), 0.6 * static_cast<double>(report_.points));
}

TEST_F(ExportFiles, ASurfaceWithoutAlbedoIsWithoutColour) {
  ExportedSurface bare = ball_;
  bare.albedo = {};
  bare.normal_sigma_rad = {};
  const auto made = WriteSurface(folder_, bare, {ExportFormat::kGlb, ExportFormat::kCloud}, [](const std::string&) {});
  ASSERT_TRUE(made.ok());
  EXPECT_EQ(made->points, report_.points);
  const GlbRead glb = ReadGlb(folder_ / "mesh.glb");
  EXPECT_THAT(FaultsOf(glb), IsEmpty());
  EXPECT_THAT(glb.uv, IsEmpty());
  EXPECT_FALSE(glb.json.contains("images"));
  EXPECT_FALSE(ReadPly(folder_ / "cloud.ply").columns.contains("red"));
  bare.surface.mask = Image<uint8_t>(kWidth, kHeight);
  EXPECT_EQ(WriteSurface(folder_, bare, {ExportFormat::kExr}, [](const std::string&) {}).status().code(),
            StatusCode::kNotFound);
}

// One colour of a mono camera is grey; what lies beside takes after it.
TEST(AlbedoPicture, IsFilledFromTheNearestAndGreyOfAMonoCamera) {
  Image<float> albedo(5, 3, 1, std::nanf(""));
  albedo(1, 1) = 1.0F;
  albedo(4, 1) = 0.0F;
  const Image<uint8_t> picture = AlbedoPicture(albedo);
  ASSERT_EQ(picture.channels(), 3);
  for (int k = 0; k < 3; ++k) {
    EXPECT_EQ(picture(0, 0, k), 255);
    EXPECT_EQ(picture(2, 2, k), 255);
    EXPECT_EQ(picture(3, 1, k), 0);
  }
}

}  // namespace
}  // namespace stratalux::fit
