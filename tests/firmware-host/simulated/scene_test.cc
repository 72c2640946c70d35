// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/scene.h"

#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

// From where projectors stand to somewhere at `target_z_mm`, at most `half` beside the axis.
Ray3 RandomRay(Random& random, const Eigen::Vector2d& half, double target_z_mm) {
  const Eigen::Vector3d origin(random.Uniform(-450, 450), random.Uniform(-300, 300), random.Uniform(0, 20));
  const Eigen::Vector3d target(random.Uniform(-half.x(), half.x()), random.Uniform(-half.y(), half.y()), target_z_mm);
  return {origin, (target - origin).normalized()};
}

TEST(Scene, RefusesAnUnknownNameAndListsTheKnownOnes) {
  const auto scene = Scene::Create("torus", 1);
  ASSERT_FALSE(scene.ok());
  EXPECT_EQ(scene.status().code(), StatusCode::kUsage);
  EXPECT_NE(scene.status().message().find("'torus'"), std::string::npos);
  EXPECT_NE(scene.status().message().find("head, plane, sphere"), std::string::npos);
}

TEST(Scene, RaysEndOnTheSurfaceAndMeetNothingBefore) {
  for (const char* name : {"head", "plane", "sphere"}) {
    const Scene scene = *Scene::Create(name, 4);
    Random random(11);
    int hits = 0;
    for (int k = 0; k < 300; ++k) {
      const auto [origin, direction] = RandomRay(random, {60, 80}, 700.0);
      const auto hit = scene.Intersect({origin, direction});
      if (!hit) continue;
      ++hits;
      EXPECT_NEAR(hit->z(), scene.Height(hit->x(), hit->y()), 1e-4) << name;
      EXPECT_LT((*hit - origin).cross(direction).norm(), 1e-6) << name;
      const double length = (*hit - origin).norm();
      for (double s = length - 150.0; s < length - 1.0; s += 0.5) {
        const Eigen::Vector3d p = origin + s * direction;
        const double height = scene.Height(p.x(), p.y());
        if (!std::isnan(height)) {
          ASSERT_LT(p.z(), height + 0.25) << name << ": passes through the surface";
        }
      }
    }
    EXPECT_GT(hits, 200) << name;
  }
}

TEST(Scene, ARayThatMeetsNothingPassesInFrontOfAllThatItPasses) {
  for (const char* name : {"head", "sphere"}) {
    const Scene scene = *Scene::Create(name, 4);
    Random random(12);
    int misses = 0;
    for (int k = 0; k < 1500; ++k) {
      const auto [origin, direction] = RandomRay(random, {160, 160}, 720.0);
      if (scene.Intersect({origin, direction})) continue;
      ++misses;
      double before = std::nan("");
      for (double s = (560.0 - origin.z()) / direction.z(); s < (800.0 - origin.z()) / direction.z(); s += 0.25) {
        const Eigen::Vector3d p = origin + s * direction;
        const double depth = p.z() - scene.Height(p.x(), p.y());
        // The table that rays are marched through ends up to a cell before the surface does.
        const bool is_rim = std::isnan(scene.Height(p.x() - 1, p.y()) + scene.Height(p.x() + 1, p.y()) +
                                       scene.Height(p.x(), p.y() - 1) + scene.Height(p.x(), p.y() + 1));
        ASSERT_FALSE(before < -0.05 && depth > 0.05 && !is_rim) << name << ": goes in at " << p.transpose();
        before = depth;
      }
    }
    EXPECT_GT(misses, 100) << name;
  }
}

TEST(Scene, PointsAreHiddenFromEachOtherByWhatStandsBetween) {
  const Scene head = *Scene::Create("head", 4);
  Random random(13);
  int hidden = 0, seen = 0;
  for (int k = 0; k < 2000; ++k) {
    Eigen::Vector3d ends[2];
    for (Eigen::Vector3d& end : ends) {
      end = {random.Uniform(-70, 70), random.Uniform(-100, 100), 0.0};
      end.z() = head.Height(end.x(), end.y());
    }
    const double length = (ends[1] - ends[0]).norm();
    double deepest = -1e9;  // beneath the surface, away from the ends
    for (double s = 2.0; s < length - 2.0; s += 0.25) {
      const Eigen::Vector3d p = ends[0] + (ends[1] - ends[0]) * (s / length);
      deepest = std::max(deepest, p.z() - head.Height(p.x(), p.y()));
    }
    if (std::abs(deepest) < 1.0) continue;
    EXPECT_EQ(head.Hides(ends[0], ends[1]), deepest > 0.0) << ends[0].transpose() << " to " << ends[1].transpose();
    ++(deepest > 0.0 ? hidden : seen);
  }
  EXPECT_GT(hidden, 100);
  EXPECT_GT(seen, 20);
}

TEST(Scene, ARayThatComesInBehindTheEdgeMeetsNothing) {
  const Scene sphere = *Scene::Create("sphere", 1);  // its edge lies at z = 760
  for (const double below : {0.01, 1.0, 12.7, 30.0})
    for (const double y : {0.0, 40.0, 79.9})
      EXPECT_FALSE(sphere.Intersect({{-200.0, y, 760.0 + below}, Eigen::Vector3d(1.0, 0.0, 1e-4).normalized()}))
          << below << " mm behind it, y = " << y;
  EXPECT_TRUE(sphere.Intersect({{-200.0, 0.0, 740.0}, Eigen::Vector3d(1.0, 0.0, 1e-4).normalized()}));
}

TEST(Scene, NormalsAreThoseOfTheShapes) {
  const Scene sphere = *Scene::Create("sphere", 1);
  const Scene plane = *Scene::Create("plane", 1);
  const double tilt = 10.0 * M_PI / 180.0;
  for (const double x : {-40.0, 0.0, 25.0})
    for (const double y : {-30.0, 10.0}) {
      const Eigen::Vector3d on_sphere(x, y, sphere.Height(x, y));
      const Eigen::Vector3d outward = (on_sphere - Eigen::Vector3d(0, 0, 760)).normalized();
      EXPECT_LT((sphere.Normal(on_sphere) - outward).norm(), 1e-5);
      const Eigen::Vector3d on_plane(x, y, plane.Height(x, y));
      EXPECT_LT((plane.Normal(on_plane) - Eigen::Vector3d(std::sin(tilt), 0, -std::cos(tilt))).norm(), 1e-6);
    }
}

TEST(Scene, AnotherSeedIsAnotherFaceAndAnotherSkin) {
  const Scene one = *Scene::Create("head", 1), same = *Scene::Create("head", 1), other = *Scene::Create("head", 2);
  double shape = 0.0, skin = 0.0;
  for (double x = -40; x <= 40; x += 10)
    for (double y = -60; y <= 60; y += 10) {
      const Eigen::Vector3d p(x, y, one.Height(x, y));
      EXPECT_EQ(one.Height(x, y), same.Height(x, y));
      EXPECT_EQ(one.Skin(p).melanin, same.Skin(p).melanin);
      EXPECT_EQ(one.Skin(p).blood, same.Skin(p).blood);
      shape = std::max(shape, std::abs(one.Height(x, y) - other.Height(x, y)));
      skin = std::max<double>(skin, std::abs(one.Skin(p).melanin / other.Skin(p).melanin - 1.0F));
    }
  EXPECT_GT(shape, 1.0) << "mm";
  EXPECT_GT(skin, 0.1);
}

TEST(Scene, SkinStaysWithinTheTable) {
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    const Scene scene = *Scene::Create("head", seed);
    for (double x = -60; x <= 60; x += 6)
      for (double y = -90; y <= 90; y += 6) {
        const SkinParameters skin = scene.Skin({x, y, 0});
        ASSERT_GE(skin.melanin, 0.003F);
        ASSERT_LE(skin.melanin, 0.3F);
        ASSERT_GE(skin.blood, 0.0005F);
        ASSERT_LE(skin.blood, 0.06F);
      }
  }
}

TEST(Scene, UniformSkinIsTheSameEverywhere) {
  Scene scene = *Scene::Create("head", 1);
  scene.UseUniformSkin({0.05F, 0.006F});
  for (double x = -60; x <= 60; x += 3)
    for (double y = -90; y <= 90; y += 3) {
      ASSERT_FLOAT_EQ(scene.Skin({x, y, 0}).melanin, 0.05F);
      ASSERT_FLOAT_EQ(scene.Skin({x, y, 0}).blood, 0.006F);
    }
}

}  // namespace
}  // namespace stratalux::rig
