// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/rig_description.h"

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

TEST(RigDescription, IsAValidRigOfFourProjectorsThatLookAtTheSubject) {
  const RigCalibration rig = DescribeSimulatedRig({});
  EXPECT_TRUE(rig.Validate().ok()) << rig.Validate().message();
  ASSERT_EQ(rig.projectors.size(), 4U);
  for (const ProjectorCalibration& p : rig.projectors) {
    const auto at = p.ProjectFromCamera({0, 4, 700});
    ASSERT_TRUE(at.has_value());
    EXPECT_LT((*at - Eigen::Vector2d(p.model.cx, p.model.cy)).norm(), 1e-6) << p.name;
    // Right way up: +x of the camera is a higher column, +y a higher row.
    EXPECT_GT(p.ProjectFromCamera({10, 4, 700})->x(), at->x()) << p.name;
    EXPECT_GT(p.ProjectFromCamera({0, 14, 700})->y(), at->y()) << p.name;
  }
}

TEST(RigDescription, FieldsOfViewDoNotDependOnTheResolution) {
  SimulatedRigOptions small;
  small.camera_width = 232;
  small.camera_height = 174;
  small.projector_width = 256;
  small.projector_height = 192;
  const RigCalibration a = DescribeSimulatedRig({}), b = DescribeSimulatedRig(small);
  for (const double x : {-100.0, 0.0, 100.0}) {
    const Eigen::Vector3d point(x, 20, 700);
    const double ca = (a.camera.model.Project(point)->x() + 0.5) / 1392,
                 cb = (b.camera.model.Project(point)->x() + 0.5) / 232;
    EXPECT_NEAR(ca, cb, 1e-9);
    for (size_t p = 0; p < 4; ++p)
      EXPECT_NEAR(a.projectors[p].ProjectFromCamera(point)->x() / 1024,
                  b.projectors[p].ProjectFromCamera(point)->x() / 256, 0.03);
  }
}

TEST(RigDescription, AWhiteTargetStaysBelowSaturation) {
  const RigCalibration rig = DescribeSimulatedRig({});
  const Eigen::Vector3d point(0, 4, 700);
  for (const ProjectorCalibration& p : rig.projectors)
    for (int c = 0; c < 3; ++c) {
      const double dn = p.WhiteTargetDn(point, (p.CentreInCamera() - point).normalized(), c, 16.0);
      EXPECT_GT(dn, 1000.0);
      EXPECT_LT(dn, rig.camera.saturation_dn - rig.camera.black_level_dn);
    }
}

}  // namespace
}  // namespace stratalux::rig
