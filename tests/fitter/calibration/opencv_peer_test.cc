// SPDX-License-Identifier: Apache-2.0
// Side by side with OpenCV on the corners of a simulated rig (real boards: real_boards_test.cc).
#include "tests/fitter/calibration/opencv_peer.h"

#include <iostream>

#include <gtest/gtest.h>

#include "tests/fitter/calibration/synthetic_boards.h"

namespace stratalux::fit {
namespace {

TEST(OpenCvPeer, FindsARigWithoutNoise) {
  // The peer is used as it should be: without noise it is as good as exact (single precision corners).
  const RigGeometry rig = ExampleRig(1);
  const auto pairs = CalibrateByOpenCv(Observe(rig, ExamplePoses(), {0.0, 0.0}, 1),
                                       {DistortionModel::kK1K2, PairIntrinsics::kRefined});
  ASSERT_TRUE(pairs.ok()) << pairs.status().message();
  EXPECT_NEAR((*pairs)[0].camera.fx, rig.camera.fx, 0.5);
  EXPECT_NEAR((*pairs)[0].projectors[0].model.fx, rig.projectors[0].model.fx, 0.5);
  EXPECT_NEAR((*pairs)[0].projectors[0].camera_from_projector.translation_mm.norm(),
              rig.projectors[0].camera_from_projector.translation_mm.norm(), 0.1);
}

TEST(OpenCvPeer, PredictsHeldOutPosesNoBetterThanTheJointAdjustment) {
  auto observations = Observe(ExampleRig(2), ExamplePoses(), {}, 23);
  std::erase_if(observations.poses, [](const PoseObservation& pose) { return pose.pose % 2 != 0; });
  const double ours_px = HeldOutOfOurs(observations);
  const PeerResult theirs = BestOfOpenCv(observations);
  std::cout << "held out: ours " << ours_px << ", stereoCalibrate at its best (" << theirs.settings << ") "
            << theirs.held_out_px << " px\n";
  EXPECT_LE(ours_px, theirs.held_out_px);
}

}  // namespace
}  // namespace stratalux::fit
