// SPDX-License-Identifier: Apache-2.0
// The public captures of a real projector and camera: skipped where they are not installed.
#include "tests/fitter/calibration/real_boards.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <iostream>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "fitter/calibration/calibrate_rig.h"
#include "fitter/calibration/verdict.h"
#include "fitter/reconstruction/smooth_surface.h"
#include "fitter/reconstruction/triangulate.h"
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

// Of points that lie within 3 mm of it at last; the first round takes all within 100.
double PlaneRms(const SurfaceMap& surface, const Image<uint8_t>& of, int64_t& inliers, int64_t& points) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
  double rms = 0.0;
  for (double limit_mm = 1e9; limit_mm > 2.9; limit_mm = limit_mm > 1e8 ? 96.0 : limit_mm / 2.0) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
    double residuals = 0.0;
    inliers = points = 0;
    for (int j = 0; j < surface.height(); ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0 || of(i, j) == 0) continue;
        ++points;
        const Eigen::Vector3d p = surface.Point(i, j);
        const double off = normal.dot(p - centre);
        if (std::abs(off) > limit_mm) continue;
        ++inliers;
        residuals += off * off;
        sum += p;
        squares += p * p.transpose();
      }
    const auto n = static_cast<double>(inliers);
    rms = std::sqrt(residuals / n);
    centre = sum / n;
    normal =
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(squares / n - centre * centre.transpose()).eigenvectors().col(0);
  }
  return rms;
}

// Boards at 3.2 to 3.6 m, by one projector and the calibration that the same pictures gave.
TEST_F(RealBoards, AreDensePlanesAtThreeMetres) {
  const auto report = CalibrateRig(observations_);
  ASSERT_TRUE(report.ok());
  const RigGeometry& found = report->bundle.rig;
  const auto boards = DecodeRealBoards();
  ASSERT_TRUE(boards.ok()) << boards.status().message();
  for (size_t k = 0; k < boards->size(); ++k) {
    const DecodedBoard& board = boards->at(k);
    RigCalibration rig;
    rig.camera.cfa = Cfa::kMono;
    rig.camera.model = found.camera;
    rig.camera.model.width = board.lit.width();
    rig.camera.model.height = board.lit.height();
    rig.camera.model.cx -= board.crop_px.x();
    rig.camera.model.cy -= board.crop_px.y();
    ProjectorCalibration projector;
    projector.model = found.projectors[0].model;
    projector.camera_from_projector = found.projectors[0].camera_from_projector;
    rig.projectors = {projector};
    const auto rough = Triangulate({&board.map, 1}, rig);
    ASSERT_TRUE(rough.ok());
    const auto smooth = SmoothSurface(rough->surface, rough->noise_sigma_mm, rig);
    int64_t rough_inliers = 0, inliers = 0, points = 0;
    const double rough_rms_mm = PlaneRms(rough->surface, board.lit, rough_inliers, points);
    const double rms_mm = PlaneRms(*smooth, board.lit, inliers, points);
    const auto lit = static_cast<double>(std::ranges::count(board.lit.pixels(), 1));
    std::cout << "pose " << k << ": " << static_cast<double>(points) / lit << " of the lit pixels have a point, "
              << static_cast<double>(inliers) / static_cast<double>(points) << " of them within 3 mm of a plane, rms "
              << rms_mm << " mm (before smoothing " << rough_rms_mm << ", "
              << static_cast<double>(rough_inliers) / static_cast<double>(points) << ")\n";
    EXPECT_GE(static_cast<double>(points), 0.95 * lit) << "pose " << k;
    EXPECT_GE(static_cast<double>(inliers), 0.95 * static_cast<double>(points)) << "pose " << k;
    EXPECT_LE(rms_mm, 0.7) << "pose " << k;
  }
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
