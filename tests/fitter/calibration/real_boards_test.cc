// SPDX-License-Identifier: Apache-2.0
// The public captures of a real projector and camera (procam-calibration, MIT): skipped where they are not installed.
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "fitter/calibration/calibrate_rig.h"
#include "fitter/calibration/observe_board.h"
#include "fitter/calibration/verdict.h"
#include "fitter/structured_light/gray_decoder.h"
#include "shared/image/png.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

fs::path Folder() {
  const char* named = std::getenv("STRATALUX_DATA");
  const fs::path data =
      named != nullptr ? fs::path(named) : fs::path(STRATALUX_SOURCE_DIR).parent_path() / "shared" / "data";
  return data / "procam_gray_kamino";
}

std::vector<Image<uint16_t>> ReadPose(int pose) {
  std::vector<Image<uint16_t>> frames;
  for (int k = 0; k < 42; ++k) {
    char name[32];
    std::snprintf(name, sizeof name, "pose%d/g%02d.png", pose, k);
    auto frame = ReadPng(Folder() / name, nullptr);
    EXPECT_TRUE(frame.ok()) << frame.status().message();
    if (frame.ok()) frames.push_back(std::move(frame).value());
  }
  return frames;
}

// From the frames themselves: search, motion, decoding, look-up.
PoseObservation ObservePose(int pose, const Eigen::Vector2d& crop, const BoardDescription& board) {
  const auto frames = ReadPose(pose);
  Image<float> black(frames[41].width(), frames[41].height()), twice = black;
  Image<uint16_t> codes(black.width(), black.height());
  for (size_t i = 0; i < black.size(); ++i) {
    black.pixels()[i] = frames[41].pixels()[i];
    twice.pixels()[i] = 2.0F * black.pixels()[i];
    codes.pixels()[i] = static_cast<uint16_t>(frames[38].pixels()[i] + frames[39].pixels()[i]);
  }
  std::vector<ProjectorPictures> pictures(1);
  pictures[0].white_light = BoardLight(frames[40], black, Cfa::kMono);
  pictures[0].codes_light = BoardLight(codes, twice, Cfa::kMono);
  pictures[0].saturated = Image<uint8_t>(black.width(), black.height());
  PoseObservation observation{pose, "pose " + std::to_string(pose), {}};
  const auto corners = FindStillBoard(pictures, board);
  EXPECT_TRUE(corners.ok()) << corners.status().message();
  if (!corners.ok()) return observation;

  DecodeInput input{.white = frames[40].view(), .black = black};
  input.columns.count = 1024;
  input.rows.count = 1024;
  for (size_t bit = 0; bit < 10; ++bit) {
    input.columns.bits.push_back({frames[2 * bit].view(), frames[2 * bit + 1].view()});
    input.rows.bits.push_back({frames[20 + 2 * bit].view(), frames[21 + 2 * bit].view()});
  }
  const auto decoded = DecodeGray(input, {.saturation_dn = 255.0, .gain_e_per_dn = 20.0, .read_noise_dn = 1.0});
  EXPECT_TRUE(decoded.ok());
  const auto seen = LookUpCorners(decoded->map, *corners, {1024, 1024});
  EXPECT_TRUE(seen.ok() && seen->seen);
  for (size_t i = 0; i < corners->size(); ++i)
    observation.corners.push_back({(*corners)[i].corner, (*corners)[i].pixel_px + crop, {seen->column_row[i]}});
  return observation;
}

// Shared by the tests: reading and decoding 210 pictures takes seconds.
// One camera and one projector, as OpenCV's calibration gives them.
RigGeometry FromOpenCv(const cv::Mat& camera, const cv::Mat& camera_distortion, const cv::Mat& projector,
                       const cv::Mat& projector_distortion, const cv::Mat& turn, const cv::Mat& shift) {
  auto pinhole = [](int width, int height, const cv::Mat& m, const cv::Mat& d) {
    Pinhole p{width, height, m.at<double>(0, 0), m.at<double>(1, 1), m.at<double>(0, 2), m.at<double>(1, 2), {}};
    for (int i = 0; i < 5; ++i) p.distortion[static_cast<size_t>(i)] = d.at<double>(i);
    return p;
  };
  Rigid3 projector_from_camera;
  Eigen::Matrix3d rotation;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) rotation(i, j) = turn.at<double>(i, j);
  projector_from_camera.rotation = Eigen::Quaterniond(rotation);
  projector_from_camera.translation_mm = {shift.at<double>(0), shift.at<double>(1), shift.at<double>(2)};
  return {pinhole(1280, 1024, camera, camera_distortion),
          {{pinhole(1024, 768, projector, projector_distortion), projector_from_camera.Inverse()}}};
}

class RealBoards : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (!fs::exists(Folder() / "crops.txt")) return;
    observations_.board = {BoardKind::kChess, 10, 8, 75.0, 0.0};
    observations_.camera = {1280, 1024};
    observations_.projectors = {{1024, 768}};
    std::ifstream in(Folder() / "crops.txt");
    for (std::string line; std::getline(in, line);) {
      if (line.empty() || line[0] == '#') continue;
      std::istringstream text(line);
      int pose = 0;
      Eigen::Vector2d crop;
      text >> pose >> crop.x() >> crop.y();
      observations_.poses.push_back(ObservePose(pose, crop, observations_.board));
    }
  }
  void SetUp() override {
    if (observations_.poses.empty())
      GTEST_SKIP() << Folder() << " is absent; set STRATALUX_DATA to the folder of the test data";
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
  cv::FileStorage file((Folder() / "published_calibration_result.xml").string(), cv::FileStorage::READ);
  ASSERT_TRUE(file.isOpened());
  cv::Mat camera, camera_distortion, projector, projector_distortion, turn, shift;
  file["cam_int"] >> camera;
  file["cam_dist"] >> camera_distortion;
  file["proj_int"] >> projector;
  file["proj_dist"] >> projector_distortion;
  file["roration"] >> turn;  // spelt so in the file
  file["translation"] >> shift;
  const RigGeometry published = FromOpenCv(camera, camera_distortion, projector, projector_distortion, turn, shift);
  const auto findings = JudgeGiven(published, *report);
  ASSERT_TRUE(IsRefused(findings));
  bool focal = false;
  for (const Finding& f : findings) {
    std::cout << f.what << "\n";
    focal = focal || f.what.find("projector 0: fx") != std::string::npos;
  }
  EXPECT_TRUE(focal);
}

// The usual pipeline: each device alone, then the pair with the intrinsics fixed. Same corners, same measure.
TEST_F(RealBoards, PredictsHeldOutPosesNoWorseThanStereoCalibrate) {
  const auto report = CalibrateRig(observations_, {.reject_sigmas = 1e6});
  ASSERT_TRUE(report.ok());
  DeviceErrors theirs(2);
  for (size_t held = 0; held < observations_.poses.size(); ++held) {
    std::vector<std::vector<cv::Point3f>> board;
    std::vector<std::vector<cv::Point2f>> seen, lit;
    for (size_t k = 0; k < observations_.poses.size(); ++k) {
      if (k == held) continue;
      board.emplace_back();
      seen.emplace_back();
      lit.emplace_back();
      for (const CornerObservation& c : observations_.poses[k].corners) {
        if (!c.projector_px[0]) continue;
        const Eigen::Vector2f mm = observations_.board.CornerMm(c.corner).cast<float>();
        board.back().emplace_back(mm.x(), mm.y(), 0.0F);
        seen.back().emplace_back(static_cast<float>(c.camera_px.x()), static_cast<float>(c.camera_px.y()));
        lit.back().emplace_back(static_cast<float>(c.projector_px[0]->x()), static_cast<float>(c.projector_px[0]->y()));
      }
    }
    cv::Mat camera, camera_k, projector, projector_k, turn, shift, essential, fundamental;
    std::vector<cv::Mat> turns, shifts;
    cv::calibrateCamera(board, seen, {1280, 1024}, camera, camera_k, turns, shifts);
    cv::calibrateCamera(board, lit, {1024, 768}, projector, projector_k, turns, shifts);
    cv::stereoCalibrate(board, seen, lit, camera, camera_k, projector, projector_k, {1280, 1024}, turn, shift,
                        essential, fundamental, cv::CALIB_FIX_INTRINSIC);
    const RigGeometry rig = FromOpenCv(camera, camera_k, projector, projector_k, turn, shift);
    // The board's place by all corners alike: the measure that favours neither.
    const auto pose = FitPose(rig, {1.0, 1.0}, observations_.board, observations_.poses[held]);
    ASSERT_TRUE(pose.has_value());
    theirs.Add(pose->errors);
  }
  std::cout << "held out: ours " << report->held_out_total.JointRms() << ", stereoCalibrate " << theirs.JointRms()
            << " px\n";
  EXPECT_LE(report->held_out_total.JointRms(), theirs.JointRms());
}

}  // namespace
}  // namespace stratalux::fit
