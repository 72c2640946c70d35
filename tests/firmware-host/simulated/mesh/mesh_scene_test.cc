// SPDX-License-Identifier: Apache-2.0
// Scenes of shape "mesh": where a file's mesh lies, which side is out, what light does on it.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/mesh.h"
#include "firmware-host/simulated/scene/scene.h"
#include "firmware-host/simulated/scene/solids.h"
#include "firmware-host/simulated/simulation_file.h"
#include "shared/base/random.h"
#include "shared/image/png.h"
#include "tests/firmware-host/simulated/mesh/small_meshes.h"
#include "tests/firmware-host/simulated/small_rig.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

using Eigen::Vector3d;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class MeshScene : public ScratchFolderTest {
 protected:
  // A scene file with [mesh] file = "a.obj" and these lines of [mesh], then others.
  std::string SceneOf(const MeshData& mesh, const std::string& mesh_keys = {}, const std::string& rest = {}) {
    WriteText(folder_ / "a.obj", ObjOf(mesh));
    WriteText(folder_ / "a.toml",
              "[subject]\nshape = \"mesh\"\n[mesh]\nfile = \"a.obj\"\n" + mesh_keys + "\n" + rest + "\n");
    return (folder_ / "a.toml").string();
  }
  Result<Scene> Make(const MeshData& mesh, const std::string& mesh_keys = {}, const std::string& rest = {}) {
    SLX_ASSIGN_OR_RETURN(const Simulation simulation, LoadSimulation(SceneOf(mesh, mesh_keys, rest)));
    return Scene::Create(simulation.scene, 1);
  }
};

// Its centre lies 60 mm behind the file's point (0, 0, 60), hence 760 mm from the camera: the shape `sphere`.
constexpr const char* kAsTheSphere = "origin_mm = [0, 0, 60]";

TEST_F(MeshScene, ASphereIsTheSphere) {
  const Scene mesh = *Make(SphereMesh(80.0, 5), kAsTheSphere), sphere = *Scene::Create("sphere", 1);
  Random random(1);
  int hits = 0;
  // The shape `sphere` has no far half: behind its rim it is a wall.
  constexpr double kRim = 755.0;
  // An equilateral facet of the longest edge, 3.3 mm, lies e^2 / (6 R) = 0.023 mm within the sphere.
  for (int k = 0; k < 3000; ++k) {
    const Vector3d origin(random.Uniform(-450, 450), random.Uniform(-300, 300), random.Uniform(0, 20));
    const Vector3d target(random.Uniform(-70, 70), random.Uniform(-70, 70), 740.0);
    const Ray3 ray{origin, (target - origin).normalized()};
    const Vector3d centre(0, 0, 760), nearest = ray.origin_mm + ray.direction.dot(centre - origin) * ray.direction;
    const auto hit = mesh.Intersect(ray), expected = sphere.Intersect(ray);
    if (hit && expected) {
      const Vector3d outward = (*expected - centre).normalized();
      const double cosine = -outward.dot(ray.direction);
      if (cosine < 0.1 || expected->z() > kRim) continue;
      ++hits;
      ASSERT_LT((*hit - *expected).norm(), 0.025 / cosine);
      // Normals of the vertices are means of facets that lean by up to e / (sqrt(3) R) = 0.024, unevenly where five
      // meet.
      ASSERT_LT((mesh.Normal(*hit) - (*hit - centre).normalized()).norm(), 2e-3);
      ASSERT_NEAR(mesh.Height(hit->x(), hit->y()), hit->z(), 1e-6);
      ASSERT_EQ(mesh.MaterialAt(*hit).kind, MaterialKind::kSkin);
      ASSERT_EQ(mesh.Skin(*hit).melanin, sphere.Skin(*hit).melanin) << "without a picture, skin by seed";
    } else if ((hit || expected) && nearest.z() < kRim) {
      // Only the rim's last hundredths differ.
      ASSERT_NEAR((nearest - centre).norm(), 80.0, 0.03);
    }
  }
  EXPECT_GT(hits, 2000);
  EXPECT_TRUE(std::isnan(mesh.Height(81, 0)));
  EXPECT_TRUE(mesh.Remarks().empty());
}

TEST_F(MeshScene, HidesWhatTheSphereHides) {
  const Scene mesh = *Make(SphereMesh(80.0, 5), kAsTheSphere), sphere = *Scene::Create("sphere", 1);
  Random random(2);
  int hidden = 0;
  for (int k = 0; k < 2000; ++k) {
    Vector3d ends[2];
    for (Vector3d& end : ends) {
      const double x = random.Uniform(-55, 55), y = random.Uniform(-55, 55);
      end = {x, y, mesh.Height(x, y)};
    }
    if ((ends[0] - ends[1]).norm() < 7.0) continue;  // nearer, it is a matter of hundredths of a millimetre
    ASSERT_EQ(mesh.Hides(ends[0], ends[1]), sphere.Hides(ends[0], ends[1]));
    hidden += mesh.Hides(ends[0], ends[1]);
  }
  EXPECT_GT(hidden, 1500);
}

TEST_F(MeshScene, NothingHidesWithinABowlAndAWallHides) {
  // The far half of a sphere, seen from inside, which a file may well wind outwards.
  MeshData bowl = SphereMesh(80.0, 4);
  std::erase_if(bowl.triangles, [&](const MeshData::Triangle& t) {
    return bowl.vertices[t.vertex[0]].z() + bowl.vertices[t.vertex[1]].z() + bowl.vertices[t.vertex[2]].z() > 0.0;
  });
  const Scene inside = *Make(bowl, "origin_mm = [0, 0, -40]");  // centre at 660
  const Vector3d deepest(0, 0, inside.Height(0, 0));
  EXPECT_NEAR(deepest.z(), 740.0, 0.1);
  EXPECT_LT((inside.Normal(deepest) - Vector3d(0, 0, -1)).norm(), 0.02) << "inside is out";
  for (double x = -60; x <= 60; x += 7)
    for (double y = -40; y <= 40; y += 9) {
      const Vector3d p(x, y, inside.Height(x, y)), q(-y, 0.7 * x, inside.Height(-y, 0.7 * x));
      ASSERT_FALSE(inside.Hides(p, q)) << x << ", " << y;
    }
  // A board in front of which a wall stands.
  MeshData wall;
  wall.vertices = {{-50, -50, 0}, {50, -50, 0}, {50, 50, 0}, {-50, 50, 0}};
  wall.triangles = {{{0, 1, 2}}, {{0, 2, 3}}};
  const MeshData cube = CubeMesh(1.0);
  for (const Vector3d& v : cube.vertices) wall.vertices.emplace_back(2.0 * v.x(), 30.0 * v.y(), 10.0 + 10.0 * v.z());
  for (const auto& t : cube.triangles) wall.triangles.push_back({{t.vertex[0] + 4, t.vertex[1] + 4, t.vertex[2] + 4}});
  const Scene walled = *Make(wall, "origin_mm = [0, 0, 0]\ncrease_deg = 40");
  const Vector3d left(-20, 0, 700), right(20, 0, 700), above_left(-20, 45, 700), above_right(20, 45, 700);
  EXPECT_NEAR(walled.Height(-20, 0), 700.0, 1e-9);
  EXPECT_NEAR(walled.Height(0, 0), 680.0, 1e-9);
  EXPECT_TRUE(walled.Hides(left, right));
  EXPECT_FALSE(walled.Hides(above_left, above_right));
  EXPECT_FALSE(walled.Hides(left, above_left));
  EXPECT_FALSE(walled.Hides(left, {-2, 0, 690})) << "the wall's side sees the board";
}

TEST_F(MeshScene, LiesWhereTheDescriptionPutsIt) {
  MeshData box = CubeMesh(1.0);
  for (Vector3d& v : box.vertices) v = v.cwiseProduct(Vector3d(30, 50, 20)) + Vector3d(7, 8, 9);
  // By itself: the box's middle on the axis, its front where a nose is.
  const Scene alone = *Make(box);
  EXPECT_NEAR(alone.Height(0, 0), 660.0, 1e-9);
  EXPECT_FALSE(std::isnan(alone.Height(29.9, -49.9)));
  EXPECT_TRUE(std::isnan(alone.Height(30.1, 0)));
  EXPECT_TRUE(std::isnan(alone.Height(0, 50.1)));
  // A point of the file, and the pose of the subject.
  const Scene placed = *Make(box, "origin_mm = [37, 58, 29]");  // right, upper, front corner
  EXPECT_NEAR(placed.Height(-1, 1), 700.0, 1e-9);
  EXPECT_TRUE(std::isnan(placed.Height(1, 1)));
  EXPECT_TRUE(std::isnan(placed.Height(-1, -1)));
  // A metre's file whose up is z, and whose face looks along -x.
  MeshData metres = box;
  for (Vector3d& v : metres.vertices) v = 1e-3 * Vector3d(-v.z(), -v.x(), v.y());
  const Scene turned = *Make(metres, "up = \"+z\"\nfront = \"-x\"\nunit_mm = 1000\norigin_mm = [-29, -37, 58]");
  EXPECT_NEAR(turned.Height(-1, 1), 700.0, 1e-9);
  EXPECT_TRUE(std::isnan(turned.Height(1, 1)));
  EXPECT_TRUE(std::isnan(turned.Height(-1, -1)));
  EXPECT_NEAR(turned.Height(-59.9, 99.9), 700.0, 1e-9);
  EXPECT_TRUE(std::isnan(turned.Height(-60.1, 99)));
}

TEST_F(MeshScene, FacesWoundTheOtherWayAreTurned) {
  const MeshData ball = SphereMesh(80.0, 3);
  MeshData wound = ball, mixed = ball;
  for (auto& t : wound.triangles) std::swap(t.vertex[0], t.vertex[1]);
  for (size_t i = 0; i < mixed.triangles.size(); i += 10)
    std::swap(mixed.triangles[i].vertex[0], mixed.triangles[i].vertex[1]);
  const Scene one = *Make(ball, kAsTheSphere), other = *Make(wound, kAsTheSphere);
  for (double x = -60; x <= 60; x += 7)
    for (double y = -40; y <= 40; y += 9) {
      const Vector3d p(x, y, one.Height(x, y));
      ASSERT_EQ(p.z(), other.Height(x, y));
      ASSERT_LT((one.Normal(p) - other.Normal(p)).norm(), 1e-12);
    }
  EXPECT_TRUE(other.Remarks().empty());
  // Sharp creases keep each face's own side.
  const Scene patchy = *Make(mixed, std::string(kAsTheSphere) + "\ncrease_deg = 60");
  EXPECT_THAT(patchy.Remarks(), ElementsAre(HasSubstr("shows its back")));
}

TEST_F(MeshScene, PoresAreOneSurfaceInDepthAndNormal) {
  const MeshData ball = SphereMesh(80.0, 5);
  const Scene smooth = *Make(ball, kAsTheSphere), pores = *Make(ball, std::string(kAsTheSphere) + "\nrelief_mm = 0.05"),
              others = *Make(ball, std::string(kAsTheSphere) + "\nrelief_mm = 0.05", "[skin]\nmelanin = 0.03");
  Random random(5);
  double deepest = 0.0, sum = 0.0, steepest = 0.0;
  constexpr int kPoints = 4000;
  for (int k = 0; k < kPoints; ++k) {
    const double x = random.Uniform(-30, 30), y = random.Uniform(-30, 30);
    const double depth = pores.Height(x, y) - smooth.Height(x, y);
    ASSERT_GE(depth, -1e-9);
    ASSERT_LT(depth, 0.15);
    deepest = std::max(deepest, depth);
    sum += depth;
    const Vector3d p(x, y, pores.Height(x, y)), n = pores.Normal(p);
    ASSERT_NEAR(n.norm(), 1.0, 1e-12);
    // The slope of what is seen: facets beneath differ from the smooth normal by up to a degree.
    constexpr double kStep = 2e-3;
    const double dx = (pores.Height(x + kStep, y) - pores.Height(x - kStep, y)) / (2 * kStep),
                 dy = (pores.Height(x, y + kStep) - pores.Height(x, y - kStep)) / (2 * kStep);
    ASSERT_LT((Vector3d(dx, dy, -1.0).normalized() - n).norm(), 0.05) << x << ", " << y;
    steepest = std::max(steepest, (n - smooth.Normal(p)).norm());
    ASSERT_EQ(others.Height(x, y), pores.Height(x, y)) << "by the seed alone";
  }
  EXPECT_GT(deepest, 0.03);
  EXPECT_GT(steepest, 0.2) << "pores show";
  EXPECT_GT(sum / kPoints, 0.0005);
  EXPECT_LT(sum / kPoints, 0.01) << "most of the skin is between them";
}

TEST_F(MeshScene, EveryComplaintNamesFileKeyAndRemedy) {
  const MeshData cube = CubeMesh(60.0);
  const struct {
    std::string keys, rest;
    const char* complaint;
  } cases[] = {
      {"unit_mm = 0.01", "", "a.obj: 1.2 mm long at [mesh] unit_mm = 0.01; allowed: 10 to 1000 mm"},
      {"unit_mm = 10", "", "a.obj: 1200 mm long at [mesh] unit_mm = 10"},
      {"origin_mm = [0, 0, -500]", "", "comes within 140 mm of the camera at [mesh] origin_mm = [0, 0, -500]"},
      {"origin_mm = [0, 0]", "", ":5: origin_mm takes three numbers"},
      {"up = \"y\"", "", ":5: mesh.up: value 'y' is unknown, allowed: +x, -x"},
      {"up = \"+z\"", "", "[mesh] up and front lie along the same axis"},
      {"subdivisions = 2\ncrease_deg = 30", "", "leave crease_deg out"},
      {"subdivisions = 9", "", ":5"},
      {"relief_mm = 3", "", ":5"},
      {"albedo = \"a.png\"", "", "a.obj: some faces have no texture coordinates, which [mesh] albedo needs"},
      {"albedo = \"a.png\"", "[skin]\nmelanin = 0.02", "[skin] melanin and blood are solved from [mesh] albedo"},
      {"albedo = \"a.png\"", "[skin]\nscar = true",
       "patches, freckles, vessels, redness and scar are of a face that is drawn"},
      {"albedo = \"a.png\"", "[skin]\nfreckles = 3",
       "patches, freckles, vessels, redness and scar are of a face that is drawn"},
  };
  for (const auto& c : cases) {
    const auto scene = Make(cube, c.keys, c.rest);
    ASSERT_FALSE(scene.ok()) << c.keys;
    EXPECT_EQ(scene.status().code(), StatusCode::kUsage) << c.keys;
    EXPECT_THAT(scene.status().message(), HasSubstr(c.complaint)) << c.keys;
  }
  WriteText(folder_ / "b.toml", "[subject]\nshape = \"mesh\"\n[mesh]\nfile = \"nobody.obj\"\n");
  const auto missing = Scene::Create(LoadSimulation((folder_ / "b.toml").string())->scene, 1);
  EXPECT_EQ(missing.status().code(), StatusCode::kUsage);
  EXPECT_THAT(missing.status().message(), HasSubstr((folder_ / "nobody.obj").string())) << "beside the scene";
  EXPECT_THAT(Scene::Create("mesh", 1).status().message(), HasSubstr("[mesh] file = \"head.obj\""));
}

// A board with a picture: its colours are where its texture coordinates say.
TEST_F(MeshScene, APictureIsSolvedForTheSkinOfEachPoint) {
  MeshData board;
  board.vertices = {{-50, -50, 0}, {50, -50, 0}, {50, 50, 0}, {-50, 50, 0}};
  board.texture = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  board.triangles = {{{0, 1, 2}, {0, 1, 2}}, {{0, 2, 3}, {0, 2, 3}}};
  const SkinTable table = *SkinTable::Load(SkinTable::DefaultPath());
  const SkinAlbedo albedo(table);
  const SkinParameters light{0.02F, 0.006F, 0.1F}, dark{0.12F, 0.003F, 0.1F};
  // The colours of two skins beside each other, below them a stripe of white.
  Image<uint8_t> picture(64, 64, 3, 255);
  const auto colour_of = [&](const SkinParameters& skin, int c) {
    return static_cast<uint8_t>(std::lround(255.0 * (1.055 * std::pow(albedo(c, skin), 1 / 2.4) - 0.055)));
  };
  for (int y = 0; y < 44; ++y)
    for (int x = 0; x < 64; ++x)
      for (int c = 0; c < 3; ++c) picture(x, y, c) = colour_of(x < 32 ? light : dark, c);
  ASSERT_TRUE(WritePng8(folder_ / "skin.png", picture).ok());
  const std::string keys = "origin_mm = [0, 0, 0]\nalbedo = \"skin.png\"",
                    skin = "[skin]\nepidermis_mm = 0.1\nscattering = 1";
  const auto description = LoadSimulation(SceneOf(board, keys, skin))->scene;
  EXPECT_THAT(Scene::Create(description, 1).status().message(), HasSubstr("solved against a skin table"));
  const Scene scene = *Scene::Create(description, 1, &table);
  // The camera's y runs down, as the picture's rows do. What eight bits tell comes back; of dark skin's blood that is
  // little.
  for (const auto& [x, expected] : {std::pair{-20.0, light}, {20.0, dark}}) {
    const SkinParameters here = scene.Skin({x, -20, 700});
    EXPECT_NEAR(here.melanin / expected.melanin, 1.0, 0.03) << x;
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(colour_of(here, c), colour_of(expected, c), 1) << x << ", colour " << c;
    EXPECT_EQ(here.epidermis_mm, 0.1F);
  }
  EXPECT_NEAR(scene.Skin({-20, 40, 700}).melanin, 0.005, 1e-4) << "white";
  // 9 of the 32 places where two triangles are looked at.
  EXPECT_THAT(scene.Remarks(), ElementsAre(HasSubstr("mesh: 28.1 % of the surface")));
  const Scene flipped =
      *Scene::Create(LoadSimulation(SceneOf(board, keys + "\nflip_v = true", skin))->scene, 1, &table);
  EXPECT_EQ(flipped.Skin({-20, 20, 700}).melanin, scene.Skin({-20, -20, 700}).melanin);
}

// The whole way: frames and truth of a rig before a sphere's mesh are those of the sphere.
TEST_F(MeshScene, FramesAndTruthOfASphereMeshAreTheSpheres) {
  Logger logger(LogLevel::kWarning);
  WriteText(folder_ / "sphere.toml", "[subject]\nshape = \"sphere\"\n");
  const auto mesh = SimulatedRig::Create(SmallRig(SceneOf(SphereMesh(80.0, 5), kAsTheSphere)), logger),
             sphere = SimulatedRig::Create(SmallRig((folder_ / "sphere.toml").string()), logger);
  ASSERT_TRUE(mesh.ok()) << mesh.status().message();
  CapturePlan plan;
  plan.options.projectors = 2;
  const auto a = (*mesh)->Truth(plan), b = (*sphere)->Truth(plan);
  ASSERT_TRUE(a.ok() && b.ok());
  ASSERT_EQ(a->size(), b->size());
  const auto normal = std::ranges::find(*b, "normal", &TruthMap::name);
  ASSERT_NE(normal, b->end());
  const Image<float>& normals = normal->map;
  for (size_t i = 0; i < a->size(); ++i) {
    const Image<float>&one = (*a)[i].map, &other = (*b)[i].map;
    const std::string& name = (*a)[i].name;
    ASSERT_EQ(name, (*b)[i].name);
    double square = 0.0, scale = 0.0;
    int both = 0, either = 0;
    const int step = one.width() / normals.width(), channels = one.channels();
    for (int k = 0; k < static_cast<int>(one.size()); ++k) {
      // Seen within 60 degrees: at the rim a hundredth of a millimetre is all the difference.
      const int x = k / channels % one.width() / step, y = k / channels / one.width() / step;
      if (!(normals(x, y, 2) < -0.5F)) continue;
      const float here = one.pixels()[k], there = other.pixels()[k];
      either += std::isfinite(here) || std::isfinite(there);
      if (!std::isfinite(here) || !std::isfinite(there)) continue;
      ++both;
      square += std::pow(here - there, 2);
      scale += std::pow(there, 2);
    }
    EXPECT_GT(both, 0.99 * either) << name;
    // A map that is nought all over, as the places of two kinds are on skin alone, allows nothing else.
    const double relative = std::sqrt(square / (scale > 0.0 ? scale : 1.0));
    std::printf("%-22s rms deviation %.5f of rms\n", name.c_str(), relative);
    // Facets lie up to 0.023 mm deep, 0.046 mm along a view at 60 degrees, of 700. Lines step with the columns, which
    // that moves by up to a hundredth of a millimetre.
    const bool line = name.starts_with("direct stripe") || name.starts_with("direct spot");
    EXPECT_LT(relative, name == "depth" ? 5e-5 : line ? 0.05 : 0.02) << name;
  }
}

}  // namespace
}  // namespace stratalux::rig
