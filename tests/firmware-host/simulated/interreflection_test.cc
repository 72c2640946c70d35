// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/interreflection.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "firmware-host/simulated/rig_description.h"
#include "firmware-host/simulated/scene/solids.h"

namespace stratalux::rig {
namespace {

struct World {
  explicit World(const SceneDescription& description)
      : scene(*Scene::Create(description, 1)), table(*SkinTable::Load(SkinTable::DefaultPath())), albedo(table) {
    SimulatedRigOptions options;
    options.camera_width = 348;
    options.camera_height = 260;
    options.projector_width = 512;
    options.projector_height = 384;
    rig = DescribeSimulatedRig(options);
    const Pinhole& camera = rig.camera.model;
    for (int y = 0; y < camera.height; y += 2)
      for (int x = 0; x < camera.width; x += 2)
        if (const auto hit = scene.Intersect({Eigen::Vector3d::Zero(), camera.Unproject({double(x), double(y)})}))
          pixels.push_back({x, y, *hit, scene.Normal(*hit), scene.MaterialAt(*hit)});
  }
  Scene scene;
  SkinTable table;
  SkinAlbedo albedo;
  RigCalibration rig;
  std::vector<SubjectPixel> pixels;
};

SceneDescription MattBowl(double albedo) {
  SceneDescription scene;
  scene.shape = ShapeKind::kBowl;
  scene.plate.light_albedo = albedo;
  return scene;
}

// Integrating sphere: the irradiance by one bounce is albedo x flux / (4 pi R^2) at every point, lit or not.
TEST(Interreflection, LightsASphereFromInsideEvenly) {
  const World world(MattBowl(0.8));
  const int projector = 1;
  const Interreflection bounce(world.scene, world.albedo, world.rig, projector, 1.0, world.pixels);
  // Flux falling into the bowl, counted ray by ray.
  const ProjectorCalibration& p = world.rig.projectors[projector];
  std::array<double, 3> flux{};
  for (int r = 0; r < p.model.height; ++r)
    for (int c = 0; c < p.model.width; ++c) {
      const Eigen::Vector3d ray = p.model.Unproject({double(c), double(r)});
      const auto hit = world.scene.Intersect({p.CentreInCamera(), p.camera_from_projector.rotation * ray});
      if (!hit || hit->z() < 660.01) continue;
      const double solid_angle =
          (p.model.Unproject({c + 0.5, double(r)}) - p.model.Unproject({c - 0.5, double(r)}))
              .cross(p.model.Unproject({double(c), r + 0.5}) - p.model.Unproject({double(c), r - 0.5}))
              .norm();
      for (int k = 0; k < 3; ++k) flux[k] += solid_angle * p.Falloff({double(c), double(r)}) * p.white_dn_mm2_per_ms[k];
    }
  std::vector<float> indirect(world.pixels.size(), 0.0F);
  bounce.Render({.kind = PatternKind::kWhite}, indirect);
  double sum = 0.0, squares = 0.0;
  int count = 0;
  for (size_t i = 0; i < indirect.size(); ++i) {
    const SubjectPixel& pixel = world.pixels[i];
    if (pixel.point.z() < 680.0) continue;  // the rim's patches hang over the edge
    const int colour = CfaColour(world.rig.camera.cfa, pixel.x, pixel.y);
    const double expected = 0.8 * 0.8 * flux[colour] / (4 * std::numbers::pi * Bowl::kRadiusMm * Bowl::kRadiusMm);
    sum += indirect[i] / expected;
    squares += std::pow(indirect[i] / expected, 2);
    ++count;
  }
  ASSERT_GT(count, 1000);
  const double mean = sum / count;
  EXPECT_NEAR(mean, 1.0, 0.02);
  EXPECT_LT(std::sqrt(squares / count - mean * mean), 0.02);
}

TEST(Interreflection, IsLinearInThePattern) {
  const World world(MattBowl(0.6));
  const Interreflection bounce(world.scene, world.albedo, world.rig, 0, 1.0, world.pixels);
  const Pattern code = {.kind = PatternKind::kGray, .bit = 2, .bits = 9};
  Pattern inverse = code;
  inverse.inverse = true;
  std::vector<float> white(world.pixels.size(), 0.0F), halves(world.pixels.size(), 0.0F), black = halves;
  bounce.Render({.kind = PatternKind::kWhite}, white);
  bounce.Render(code, halves);
  bounce.Render(inverse, halves);
  bounce.Render({.kind = PatternKind::kBlack}, black);
  for (size_t i = 0; i < white.size(); ++i) {
    ASSERT_NEAR(halves[i], white[i], 1e-4F * white[i] + 1e-6F);
    ASSERT_EQ(black[i], 0.0F);
  }
}

TEST(Interreflection, ShowsWhatAProjectorOfItsGammaDoes) {
  // Vertical stripes of full contrast light one half and are what they were; a sinusoid's mean is that of its power.
  const World world(MattBowl(0.6));
  const double gamma = 2.2;
  const Interreflection linear(world.scene, world.albedo, world.rig, 0, 1.0, world.pixels),
      bent(world.scene, world.albedo, world.rig, 0, gamma, world.pixels);
  const Pattern sinusoid = {.kind = PatternKind::kSinusoid, .period = 16, .shift = 0, .shifts = 4};
  const Pattern code = {.kind = PatternKind::kGray, .bit = 2, .bits = 9};
  std::vector<float> white(world.pixels.size(), 0.0F), waves = white, codes = white, straight = white;
  linear.Render({.kind = PatternKind::kWhite}, white);
  bent.Render(sinusoid, waves);
  bent.Render(code, codes);
  linear.Render(code, straight);
  double mean = 0.0;
  for (int k = 0; k < 16; ++k) mean += std::pow(0.5 + 0.5 * std::cos(2.0 * std::numbers::pi * k / 16.0), gamma) / 16.0;
  ASSERT_LT(mean, 0.4);
  for (size_t i = 0; i < white.size(); ++i) {
    ASSERT_NEAR(waves[i], mean * white[i], 0.01 * white[i] + 1e-6) << i;  // the last block is not a whole period
    ASSERT_EQ(codes[i], straight[i]);
  }
}

TEST(Interreflection, FlatAndConvexBodiesHaveNone) {
  for (const ShapeKind shape : {ShapeKind::kWhite, ShapeKind::kSphere}) {
    SceneDescription description;
    description.shape = shape;
    const World world(description);
    const Interreflection bounce(world.scene, world.albedo, world.rig, 2, 1.0, world.pixels);
    std::vector<float> indirect(world.pixels.size(), 0.0F);
    bounce.Render({.kind = PatternKind::kWhite}, indirect);
    for (const float v : indirect) ASSERT_EQ(v, 0.0F) << ToString(shape);
  }
}

TEST(Interreflection, AFaceReceivesMoreBesideItsNoseThanOnItsForehead) {
  SceneDescription description;
  const World world(description);
  const Interreflection bounce(world.scene, world.albedo, world.rig, 1, 1.0, world.pixels);
  std::vector<float> indirect(world.pixels.size(), 0.0F);
  bounce.Render({.kind = PatternKind::kWhite}, indirect);
  double nose = 0.0, forehead = 0.0;
  int beside = 0, above = 0;
  for (size_t i = 0; i < indirect.size(); ++i) {
    const Eigen::Vector3d& p = world.pixels[i].point;
    ASSERT_TRUE(indirect[i] >= 0.0F);
    if (std::abs(std::abs(p.x()) - 20.0) < 4.0 && std::abs(p.y() - 10.0) < 8.0) nose += indirect[i], ++beside;
    if (std::abs(p.x()) < 15.0 && std::abs(p.y() + 65.0) < 8.0) forehead += indirect[i], ++above;
  }
  ASSERT_TRUE(beside > 20 && above > 20);
  EXPECT_GT(nose / beside, 5.0 * forehead / above);
}

}  // namespace
}  // namespace stratalux::rig
