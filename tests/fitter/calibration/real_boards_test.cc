// SPDX-License-Identifier: Apache-2.0
// The public captures of a real projector and camera: skipped where they are not installed.
#include "tests/fitter/calibration/real_boards.h"

#include <iostream>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "fitter/calibration/calibrate_rig.h"
#include "fitter/calibration/verdict.h"
#include "tests/fitter/calibration/opencv_peer.h"

namespace stratalux::fit {
namespace {

// The observations are shared by the tests: reading and decoding 210 pictures takes seconds.
class RealBoards : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    auto observed = ObserveRealBoards();
    ASSERT_TRUE(observed.ok()) << observed.status().message();
    observations_ = std::move(observed).value();
  }
  void SetUp() override {
    if (observations_.poses.empty())
      GTEST_SKIP() << RealBoardsFolder() << " is absent; set STRATALUX_DATA to the folder of the test data";
  }
  static CalibrationObservations observations_;
};
CalibrationObservations RealBoards::observations_;

TEST_F(RealBoards, AreCalibratedToTheReferenceOfAnIndependentProgram) {
  const auto report = CalibrateRig(observations_);
  ASSERT_TRUE(report.ok()) << report.status().message();
  const ProjectorGeometry& projector = report->bundle.rig.projectors[0];
  std::cout << "joint " << report->training_total.JointRms() << " px, projector f " << projector.model.fx << " / "
            << projector.model.fy << ", baseline " << projector.camera_from_projector.translation_mm.norm()
            << ", epipolar " << report->epipolar.Rms(1) << " px, rejected " << report->rejected.size() << ", "
            << ToString(report->distortion) << "\n";
  for (const PoseObservation& pose : observations_.poses) EXPECT_EQ(pose.corners.size(), 63U) << pose.name;
  EXPECT_LE(report->training_total.JointRms(), 0.28);
  EXPECT_NEAR(projector.model.fx, 1889.0, 8.0);
  EXPECT_NEAR(projector.model.fy, 1889.0, 8.0);
  EXPECT_NEAR(projector.camera_from_projector.translation_mm.norm(), 675.0, 3.0);
  EXPECT_LE(report->epipolar.Rms(1), 0.06);
  for (const HeldOutPose& pose : report->held_out) {
    std::cout << pose.name << " held out: camera " << pose.errors.Rms(0) << ", projector " << pose.errors.Rms(1)
              << " px\n";
    EXPECT_LE(pose.errors.Rms(1), 0.5) << pose.name;
    EXPECT_LE(pose.errors.JointRms(), 0.5) << pose.name;
  }
  EXPECT_LE(report->rejected.size(), 315 * 0.06);
  for (const Finding& f : JudgeCalibration(*report)) EXPECT_EQ(f.severity, Severity::kWarning) << f.what;
}

TEST_F(RealBoards, ProjectorInHeldOutPosesIsWithinHalfAPixelAlsoWithAllCorners) {
  // Nothing rejected: the corners that all others contradict count, too. Of the camera, pose 1 has some.
  const auto report = CalibrateRig(observations_, {.reject_sigmas = 1e6});
  ASSERT_TRUE(report.ok());
  EXPECT_TRUE(report->rejected.empty());
  for (const HeldOutPose& pose : report->held_out) EXPECT_LE(pose.errors.Rms(1), 0.5) << pose.name;
}

TEST_F(RealBoards, PublishedResultThatIsOffByAFactorOfTwoIsRefused) {
  const auto report = CalibrateRig(observations_);
  ASSERT_TRUE(report.ok());
  cv::FileStorage file((RealBoardsFolder() / "published_calibration_result.xml").string(), cv::FileStorage::READ);
  ASSERT_TRUE(file.isOpened());
  cv::Mat turn, shift;
  OpenCvDevice camera{{1280, 1024}, {}, {}}, projector{{1024, 768}, {}, {}};
  file["cam_int"] >> camera.matrix;
  file["cam_dist"] >> camera.distortion;
  file["proj_int"] >> projector.matrix;
  file["proj_dist"] >> projector.distortion;
  file["roration"] >> turn;  // spelt so in the file
  file["translation"] >> shift;
  const RigGeometry published = RigFromOpenCv(camera, projector, turn, shift);
  const auto findings = JudgeGiven(published, *report);
  ASSERT_TRUE(IsRefused(findings));
  bool focal = false;
  for (const Finding& f : findings) {
    std::cout << f.what << "\n";
    focal = focal || f.what.find("projector 0: fx") != std::string::npos;
  }
  EXPECT_TRUE(focal);
}

TEST_F(RealBoards, PredictsHeldOutPosesNoWorseThanStereoCalibrate) {
  const double ours_px = HeldOutOfOurs(observations_);
  const PeerResult theirs = BestOfOpenCv(observations_);
  std::cout << "held out: ours " << ours_px << ", stereoCalibrate at its best (" << theirs.settings << ") "
            << theirs.held_out_px << " px\n";
  EXPECT_LE(ours_px, theirs.held_out_px);
}

}  // namespace
}  // namespace stratalux::fit
