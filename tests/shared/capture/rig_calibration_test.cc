// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/rig_calibration.h"

#include <array>
#include <cmath>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace stratalux {
namespace {

RigCalibration Example() {
  RigCalibration c;
  c.source = "test";
  c.camera.model = {1392, 1042, 3200, 3200, 700, 520, {-0.1, 0.02, 1e-4, -2e-4, 0.0}};
  ProjectorCalibration p;
  p.name = "p0";
  p.model = {1024, 768, 2690, 2690, 511, 384, {}};
  p.camera_from_projector = LookAt({-400, 0, 0}, {0, 0, 700});
  p.white_dn_mm2_per_ms = {1e8, 1.1e8, 0.9e8};
  p.falloff = {-0.1, 0.01};
  c.projectors.push_back(p);
  return c;
}

TEST(RigCalibration, RoundTripsThroughJson) {
  const RigCalibration c = Example();
  const auto back = RigCalibration::FromJson(c.ToJson());
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->ToJson(), c.ToJson());
}

TEST(RigCalibration, CovarianceTravelsWithItOrIsAbsent) {
  RigCalibration c = Example();
  EXPECT_EQ(c.ToJson().find("geometry_covariance"), std::string::npos);
  c.camera.geometry_covariance.assign(45, 0.25);
  c.projectors[0].geometry_covariance.assign(120, 0.5);
  const auto back = RigCalibration::FromJson(c.ToJson());
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->camera.geometry_covariance, c.camera.geometry_covariance);
  EXPECT_EQ(back->projectors[0].geometry_covariance, c.projectors[0].geometry_covariance);
  c.projectors[0].geometry_covariance.pop_back();
  EXPECT_EQ(RigCalibration::FromJson(c.ToJson()).status().code(), StatusCode::kUsage);
}

TEST(RigCalibration, WhiteTargetFollowsLambertAndInverseSquare) {
  ProjectorCalibration p = Example().projectors[0];
  p.falloff = {};
  const Eigen::Vector3d centre = p.CentreInCamera();
  const Eigen::Vector3d axis = (Eigen::Vector3d(0, 0, 700) - centre).normalized();
  const double near = p.WhiteTargetDn(centre + 500.0 * axis, -axis, 0, 1.0);
  EXPECT_NEAR(p.WhiteTargetDn(centre + 1000.0 * axis, -axis, 0, 1.0) / near, 0.25, 1e-12);
  const Eigen::Vector3d tilted = Eigen::AngleAxisd(M_PI / 3, Eigen::Vector3d::UnitY()) * -axis;
  EXPECT_NEAR(p.WhiteTargetDn(centre + 500.0 * axis, tilted, 0, 1.0) / near, 0.5, 1e-9);
  EXPECT_EQ(p.WhiteTargetDn(centre + 500.0 * axis, axis, 0, 1.0), 0.0);  // faces away
}

TEST(RigCalibration, RefusesWhatCannotBeARig) {
  RigCalibration c = Example();
  c.projectors[0].model.fx = -1;
  EXPECT_FALSE(c.Validate().ok());
  c = Example();
  c.projectors.clear();
  EXPECT_FALSE(c.Validate().ok());
  EXPECT_EQ(RigCalibration::FromJson("{\"schema\":1}").status().code(), StatusCode::kIntegrity);
}

TEST(RigCalibration, RefusesATurnThatIsNoneAndForgivesRounding) {
  auto json = nlohmann::json::parse(Example().ToJson());
  auto& turn = json["projectors"][0]["camera_from_projector"]["quaternion_wxyz"];
  const auto read = [&] { return RigCalibration::FromJson(json.dump()); };
  turn = {0.0, 0.0, 0.0, 0.0};
  EXPECT_EQ(read().status().code(), StatusCode::kUsage);
  EXPECT_NE(read().status().message().find("projector p0: quaternion_wxyz has length 0"), std::string::npos)
      << read().status().message();
  for (const double length : {1.0, 0.9991, 1.0009}) {
    turn = {0.6 * length, 0.0, 0.8 * length, 0.0};
    ASSERT_TRUE(read().ok()) << read().status().message();
    EXPECT_NEAR(read()->projectors[0].camera_from_projector.rotation.norm(), 1.0, 1e-12);
  }
  for (const double length : {0.998, 1.002, 2.0}) {
    turn = {0.6 * length, 0.0, 0.8 * length, 0.0};
    EXPECT_EQ(read().status().code(), StatusCode::kUsage) << length;
  }
}

TEST(RigCalibration, RefusesAFallOffThatReachesNothingWithinThePicture) {
  RigCalibration c = Example();
  for (const std::array<double, 2> dark : {std::array{-1.5, 0.0}, {0.0, -1.0}, {-2.0, 0.9}, {std::nan(""), 0.0}}) {
    c.projectors[0].falloff = dark;
    EXPECT_EQ(c.Validate().code(), StatusCode::kUsage) << dark[0];
    EXPECT_NE(c.Validate().message().find("projector p0: falloff"), std::string::npos) << c.Validate().message();
  }
  c.projectors[0].falloff = {-0.6, 0.1};
  EXPECT_TRUE(c.Validate().ok());
}

TEST(Pinhole, UnprojectInvertsProjectWithDistortion) {
  const Pinhole m = Example().camera.model;
  for (double u = 0; u < 1392; u += 130)
    for (double v = 0; v < 1042; v += 130) {
      const auto back = m.Project(650.0 * m.Unproject({u, v}));
      ASSERT_TRUE(back.has_value());
      EXPECT_NEAR(back->x(), u, 1e-8);
      EXPECT_NEAR(back->y(), v, 1e-8);
    }
  EXPECT_FALSE(m.Project({0, 0, -1}).has_value());
}

TEST(LookAt, PutsTheTargetOnTheOpticalAxis) {
  const Rigid3 pose = LookAt({-400, 50, 10}, {0, 0, 700});
  const Eigen::Vector3d target = pose.Inverse() * Eigen::Vector3d(0, 0, 700);
  EXPECT_NEAR(target.head<2>().norm(), 0.0, 1e-9);
  EXPECT_GT(target.z(), 0.0);
  EXPECT_NEAR((pose * (pose.Inverse() * Eigen::Vector3d(1, 2, 3)) - Eigen::Vector3d(1, 2, 3)).norm(), 0.0, 1e-9);
}

TEST(RigCalibration, ResponsesAndVignettingSurviveTheirJson) {
  RigCalibration rig;
  rig.camera.model = {64, 48, 80.0, 80.0, 31.5, 23.5, {}};
  rig.camera.black_level_dn = 95.0;
  rig.camera.vignetting = {-0.1, 0.02};
  rig.camera.response = {0.0, 0.5, 1.2};
  rig.projectors.emplace_back();
  rig.projectors[0].model = {128, 96, 200.0, 200.0, 63.5, 47.5, {}};
  rig.projectors[0].white_dn_mm2_per_ms = {1.0, 1.0, 1.0};
  rig.projectors[0].response = {0.0, 0.2, 1.0};
  const auto back = RigCalibration::FromJson(rig.ToJson());
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->camera.response, rig.camera.response);
  EXPECT_EQ(back->camera.vignetting, rig.camera.vignetting);
  EXPECT_EQ(back->projectors[0].response, rig.projectors[0].response);
  EXPECT_DOUBLE_EQ(back->camera.LinearDn(2000.0), 2000.0);  // half way: 0.5 of 4000
  EXPECT_DOUBLE_EQ(back->camera.LinearDn(3000.0), 3400.0);
  EXPECT_DOUBLE_EQ(back->camera.LinearDn(-3.0), -3.0);
  EXPECT_DOUBLE_EQ(back->projectors[0].Response(0.75), 0.6);
  rig.projectors[0].response = {0.0, 1.1, 1.0};
  EXPECT_EQ(RigCalibration::FromJson(rig.ToJson()).status().code(), StatusCode::kUsage);
  rig.projectors[0].response.clear();
  rig.camera.vignetting = {-1.0, 0.0};
  EXPECT_EQ(rig.Validate().code(), StatusCode::kUsage);
}

TEST(LookAt, TurnsProperlyWhereItLooksAlongDown) {
  for (const Eigen::Vector3d& down : {Eigen::Vector3d(0, 1, 0), Eigen::Vector3d(0, -2, 0), Eigen::Vector3d(3, 0, 0),
                                      Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(1, 1, 1)})
    for (const double way : {-700.0, 700.0}) {
      const Eigen::Vector3d centre(10, -20, 30), target = centre + way * down.normalized();
      const Eigen::Matrix3d rotation = LookAt(centre, target, down).rotation.toRotationMatrix();
      EXPECT_LT((rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-12) << down.transpose();
      EXPECT_NEAR(rotation.determinant(), 1.0, 1e-12) << down.transpose();
      EXPECT_LT((rotation.col(2) - (target - centre).normalized()).norm(), 1e-12) << down.transpose();
    }
}

}  // namespace
}  // namespace stratalux
