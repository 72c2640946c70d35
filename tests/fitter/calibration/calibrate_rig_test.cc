// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/calibrate_rig.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "fitter/calibration/calibration_record.h"
#include "fitter/calibration/initial_rig.h"
#include "fitter/calibration/verdict.h"
#include "tests/fitter/calibration/synthetic_boards.h"

namespace stratalux::fit {
namespace {

std::string Said(const std::vector<Finding>& findings) {
  std::string all;
  for (const Finding& f : findings)
    all += (f.severity == Severity::kRefusal ? "REFUSED " : "warning ") + f.what + " -> " + f.remedy + "\n";
  return all;
}

TEST(CalibrateRig, FindsTheRigWithinItsOwnStandardDeviations) {
  const RigGeometry truth = ExampleRig(4);
  // Squares of normal errors in units of their own sd: their mean over parameters and trials is 1.
  double sum = 0.0;
  int count = 0;
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    const auto report = CalibrateRig(Observe(truth, ExamplePoses(), {}, seed), {.distortion = DistortionModel::kK1K2});
    ASSERT_TRUE(report.ok()) << report.status().message();
    ASSERT_EQ(report->covariances.size(), 5U);
    for (size_t d = 0; d < 5; ++d) {
      const Pinhole& found = d == 0 ? report->bundle.rig.camera : report->bundle.rig.projectors[d - 1].model;
      const Pinhole& wanted = d == 0 ? truth.camera : truth.projectors[d - 1].model;
      const std::vector<double> errors = {found.fx - wanted.fx,
                                          found.fy - wanted.fy,
                                          found.cx - wanted.cx,
                                          found.cy - wanted.cy,
                                          found.distortion[0] - wanted.distortion[0],
                                          found.distortion[1] - wanted.distortion[1]};
      for (size_t i = 0; i < errors.size(); ++i) {
        const auto k = static_cast<Eigen::Index>(i);
        const double sigmas = errors[i] / std::sqrt(report->covariances[d](k, k));
        EXPECT_LT(std::abs(sigmas), 4.0) << DeviceName(d) << " " << ParameterName(static_cast<int>(i));
        sum += sigmas * sigmas;
        ++count;
      }
      if (d == 0) continue;
      const Eigen::Vector3d off = report->bundle.rig.projectors[d - 1].camera_from_projector.translation_mm -
                                  truth.projectors[d - 1].camera_from_projector.translation_mm;
      for (Eigen::Index axis = 0; axis < 3; ++axis)
        EXPECT_LT(std::abs(off[axis]), 4.0 * std::sqrt(report->covariances[d](12 + axis, 12 + axis)));
    }
    EXPECT_NEAR(report->sigma_px[0], 0.05, 0.005);
    EXPECT_NEAR(report->sigma_px[1], 0.02, 0.003);
    EXPECT_FALSE(IsRefused(JudgeCalibration(*report))) << Said(JudgeCalibration(*report));
  }
  EXPECT_GT(sum / count, 0.3);
  EXPECT_LT(sum / count, 2.5);
}

TEST(CalibrateRig, ErrorsOfFindingCornersDoNotReachTheProjectors) {
  // Corners found ten times worse move camera and projector pixels together.
  const auto report = CalibrateRig(Observe(ExampleRig(2), ExamplePoses(), {0.5, 0.02}, 3), {});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_NEAR(report->sigma_px[0], 0.5, 0.05);
  EXPECT_NEAR(report->sigma_px[1], 0.02, 0.003);
}

TEST(CalibrateRig, TakesTheTermsThatHeldOutPosesAskFor) {
  RigGeometry rig = ExampleRig(1);
  rig.camera.distortion = {-0.4, 1.5, 0.004, -0.003, 0.0};
  const auto rich = CalibrateRig(Observe(rig, ExamplePoses(), {}, 5));
  ASSERT_TRUE(rich.ok());
  EXPECT_EQ(rich->distortion, DistortionModel::kFull);
  // Whatever is chosen, no other predicts clearly better.
  const auto plain = CalibrateRig(Observe(ExampleRig(1), ExamplePoses(), {}, 6));
  ASSERT_TRUE(plain.ok());
  ASSERT_EQ(plain->trials.size(), 3U);
  const auto chosen = std::find_if(plain->trials.begin(), plain->trials.end(),
                                   [&](const ModelTrial& trial) { return trial.model == plain->distortion; });
  for (const ModelTrial& trial : plain->trials) EXPECT_LE(chosen->held_out_sigmas, 1.01 * trial.held_out_sigmas);
}

TEST(CalibrateRig, TakesFewerTermsWhereTheRestCannotPredict) {
  // Four poses and bad corners: all five terms follow the noise.
  auto o = Observe(ExampleRig(1), ExamplePoses(), {0.5, 0.5}, 6);
  o.poses.resize(4);
  const auto report = CalibrateRig(o);
  ASSERT_TRUE(report.ok()) << report.status().message();
  ASSERT_EQ(report->trials.size(), 3U);
  EXPECT_GT(report->trials[2].held_out_sigmas, 1.01 * report->trials[0].held_out_sigmas);
  EXPECT_NE(report->distortion, DistortionModel::kFull);
}

TEST(CalibrateRig, LeavesKnownIntrinsicsAlone) {
  const RigGeometry truth = ExampleRig(1);
  const auto report = CalibrateRig(Observe(truth, ExamplePoses(), {}, 7), {.known_camera = truth.camera});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->bundle.rig.camera.fx, truth.camera.fx);
  EXPECT_EQ(report->bundle.rig.camera.distortion, truth.camera.distortion);
  EXPECT_NEAR(report->bundle.rig.projectors[0].model.fx, 2690.0, 4.0 * std::sqrt(report->covariances[1](0, 0)));
}

TEST(CalibrateRig, RejectsCornersThatContradictTheOthers) {
  auto o = Observe(ExampleRig(2), ExamplePoses(), {}, 8);
  o.poses[3].corners[10].camera_px.x() += 3.0;
  *o.poses[5].corners[20].projector_px[1] += Eigen::Vector2d(0.0, -2.0);
  const auto report = CalibrateRig(o);
  ASSERT_TRUE(report.ok());
  ASSERT_GE(report->rejected.size(), 2U);
  EXPECT_LE(report->rejected.size(), 4U);
  EXPECT_EQ(report->rejected[0].pose, "pose 3");
  EXPECT_EQ(report->rejected[0].corner, o.poses[3].corners[10].corner);
  EXPECT_NEAR(report->bundle.rig.camera.fx, 3248.0, 4.0 * std::sqrt(report->covariances[0](0, 0)));
}

TEST(CalibrateRig, IsTheSameEachTime) {
  const auto o = Observe(ExampleRig(2), ExamplePoses(), {}, 9);
  const auto a = CalibrateRig(o), b = CalibrateRig(o);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_TRUE(ToRecord(*a, std::nullopt, "x").ToJson() == ToRecord(*b, std::nullopt, "x").ToJson());
}

TEST(CalibrateRig, RecordKeepsGeometryAndCovariance) {
  const auto report = CalibrateRig(Observe(ExampleRig(2), ExamplePoses(), {}, 10));
  ASSERT_TRUE(report.ok());
  const RigCalibration record = ToRecord(*report, std::nullopt, "calibration session s1");
  const auto back = RigCalibration::FromJson(record.ToJson());
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->camera.model.fx, report->bundle.rig.camera.fx);
  ASSERT_EQ(back->projectors[1].geometry_covariance.size(), 120U);
  EXPECT_EQ(back->projectors[1].geometry_covariance[0], report->covariances[2](0, 0));
  EXPECT_EQ(back->projectors[1].geometry_covariance[119], report->covariances[2](14, 14));
}

TEST(CalibrateRig, RecordHasTheSaturationOfTheSensorAtHand) {
  const auto report = CalibrateRig(Observe(ExampleRig(2), ExamplePoses(), {}, 10));
  ASSERT_TRUE(report.ok());
  for (const double saturation_dn : {255.0, 4080.0, 4092.0, 65535.0}) {
    RigCalibration record = ToRecord(*report, std::nullopt, "x", saturation_dn);
    EXPECT_EQ(record.camera.saturation_dn, saturation_dn);
    record.camera.saturation_dn = 4095.0;  // as a calibration of before had it
    EXPECT_EQ(ToRecord(*report, record, "x", saturation_dn).camera.saturation_dn, saturation_dn);
    record.camera.response = {0.0, 0.5, 1.0};
    EXPECT_EQ(ToRecord(*report, record, "x", saturation_dn).camera.saturation_dn, 4095.0) << "a curve up to that level";
  }
  RigCalibration earlier = ToRecord(*report, std::nullopt, "x", 4092.0);
  EXPECT_EQ(ToRecord(*report, earlier, "x").camera.saturation_dn, 4092.0) << "not known: as it was";
}

TEST(Verdict, RefusesBoardsThatFaceTheCamera) {
  auto poses = ExamplePoses();
  for (size_t k = 0; k < poses.size(); ++k) {
    poses[k].rotation = Eigen::AngleAxisd(0.2 * static_cast<double>(k), Eigen::Vector3d::UnitZ()) *
                        Eigen::AngleAxisd(0.02, Eigen::Vector3d::UnitX());
    poses[k].translation_mm =
        Eigen::Vector3d(0, 0, 690 + 3.0 * static_cast<double>(k)) - poses[k].rotation * Eigen::Vector3d(80, 50, 0);
  }
  const auto report = CalibrateRig(Observe(ExampleRig(2), poses, {}, 11));
  if (!report.ok()) return;  // no first guess at all: said so
  const auto findings = JudgeCalibration(*report);
  EXPECT_TRUE(IsRefused(findings));
  EXPECT_NE(Said(findings).find("tilt the board"), std::string::npos) << Said(findings);
}

TEST(Verdict, NamesTheSizeOfTheSquaresThatFits) {
  const RigGeometry rig = ExampleRig(3);
  auto o = Observe(rig, ExamplePoses(), {}, 12);
  o.board.square_mm = 25.0;  // they are 20
  const auto report = CalibrateRig(o);
  ASSERT_TRUE(report.ok());
  EXPECT_FALSE(IsRefused(JudgeCalibration(*report)));  // nothing else can tell
  const auto findings = CompareWithKnownRig(rig, *report);
  ASSERT_TRUE(IsRefused(findings));
  EXPECT_NE(Said(findings).find("20.00"), std::string::npos) << Said(findings);
}

TEST(Verdict, NamesProjectorsExchangedSinceTheLastCalibration) {
  const RigGeometry rig = ExampleRig(3);
  RigGeometry known = rig;
  std::swap(known.projectors[0], known.projectors[2]);
  const auto report = CalibrateRig(Observe(rig, ExamplePoses(), {}, 13));
  ASSERT_TRUE(report.ok());
  EXPECT_TRUE(CompareWithKnownRig(rig, *report).empty()) << Said(CompareWithKnownRig(rig, *report));
  const auto findings = CompareWithKnownRig(known, *report);
  ASSERT_TRUE(IsRefused(findings));
  EXPECT_NE(Said(findings).find("projector 0 stands where projector 2 stood"), std::string::npos) << Said(findings);
}

TEST(CalibrateRig, NamesThePoseInWhichProjectorsWereExchanged) {
  auto o = Observe(ExampleRig(4), ExamplePoses(), {}, 14);
  for (CornerObservation& corner : o.poses[6].corners) std::swap(corner.projector_px[1], corner.projector_px[3]);
  const auto report = CalibrateRig(o);
  ASSERT_FALSE(report.ok());
  EXPECT_NE(report.status().message().find("pose 6: projectors 1 and 3 are exchanged"), std::string::npos)
      << report.status().message();
}

TEST(Verdict, RefusesAPoseThatTheOthersDoNotPredict) {
  // Three poses of one projector fit anything; what they say of a fourth is worth nothing.
  auto o = Observe(ExampleRig(1), ExamplePoses(), {}, 15);
  o.poses.resize(3);
  const auto report = CalibrateRig(o, {.distortion = DistortionModel::kFull});
  if (!report.ok()) return;
  EXPECT_TRUE(IsRefused(JudgeCalibration(*report))) << Said(JudgeCalibration(*report));
}

TEST(Verdict, RefusesDistortionThatFoldsThePicture) {
  const auto report = CalibrateRig(Observe(ExampleRig(1), ExamplePoses(), {}, 16));
  ASSERT_TRUE(report.ok());
  RigGeometry given = report->bundle.rig;
  EXPECT_TRUE(JudgeGiven(given, *report).empty()) << Said(JudgeGiven(given, *report));
  given.camera.distortion = {-8.0, 0.0, 0.0, 0.0, 0.0};
  EXPECT_NE(Said(JudgeGiven(given, *report)).find("folds over"), std::string::npos);
  given = report->bundle.rig;
  given.camera.fx *= 1.04;
  EXPECT_NE(Said(JudgeGiven(given, *report)).find("camera: fx"), std::string::npos);
}

TEST(CalibrateRig, NamesADeviceWithoutEnoughPoses) {
  auto o = Observe(ExampleRig(2), ExamplePoses(), {}, 17);
  for (size_t k = 2; k < o.poses.size(); ++k)
    for (CornerObservation& corner : o.poses[k].corners) corner.projector_px[1].reset();
  const auto report = CalibrateRig(o);
  ASSERT_FALSE(report.ok());
  EXPECT_NE(report.status().message().find("projector 1 sees the board in 2 poses"), std::string::npos)
      << report.status().message();
}

TEST(CalibrateRig, RefusesKnownIntrinsicsOfAnotherPictureSize) {
  RigGeometry truth = ExampleRig(1);
  const auto o = Observe(truth, ExamplePoses(), {}, 7);
  truth.camera.width *= 2;
  truth.camera.height *= 2;
  const auto report = CalibrateRig(o, {.known_camera = truth.camera});
  ASSERT_FALSE(report.ok());
  EXPECT_EQ(report.status().code(), StatusCode::kUsage);
  for (const char* size : {"2784x2084", "1392x1042"})
    EXPECT_NE(report.status().message().find(size), std::string::npos) << report.status().message();
}

TEST(Verdict, NamesThePoseThatMostRejectedCornersLieIn) {
  auto report = CalibrateRig(Observe(ExampleRig(1), ExamplePoses(), {}, 18));
  ASSERT_TRUE(report.ok()) << report.status().message();
  report->rejected = {{"pose 1", 3, 900.0}};
  for (int corner = 0; corner < 40; ++corner) report->rejected.push_back({"pose 9", corner, 20.0});
  // Enough of them to be refused, whatever was rejected before.
  report->corners = 100;
  const std::string said = Said(JudgeCalibration(*report));
  EXPECT_NE(said.find("the worst lie in pose 9"), std::string::npos) << said;
  report->rejected.assign(40, {"pose 2", 0, 30.0});
  report->rejected.insert(report->rejected.end(), 40, {"pose 7", 0, 31.0});
  EXPECT_NE(Said(JudgeCalibration(*report)).find("the worst lie in pose 7"), std::string::npos);
}

TEST(CalibrateRig, GoesOnWithoutAPoseThatAllItsCornersContradict) {
  // In one of 24 poses a projector was pushed.
  auto poses = ExamplePoses();
  for (Rigid3 pose : ExamplePoses()) {
    pose.translation_mm += Eigen::Vector3d(-6.0, 4.0, 15.0);
    poses.push_back(pose);
  }
  auto o = Observe(ExampleRig(2), poses, {}, 19);
  for (CornerObservation& corner : o.poses[17].corners)
    if (corner.projector_px[1]) *corner.projector_px[1] += Eigen::Vector2d(3.0, 6.0);
  const auto report = CalibrateRig(o);
  ASSERT_TRUE(report.ok()) << report.status().message();
  ASSERT_EQ(report->left_out.size(), 1U);
  EXPECT_EQ(report->left_out[0].find("pose 17: nearly all of its corners"), 0U) << report->left_out[0];
  EXPECT_EQ(report->used.poses.size(), 23U);
  EXPECT_EQ(report->bundle.camera_from_board.size(), 23U);
  EXPECT_EQ(report->held_out.size(), 23U);
  const auto findings = JudgeCalibration(*report);
  EXPECT_FALSE(IsRefused(findings)) << Said(findings);
  EXPECT_NEAR(report->bundle.rig.camera.fx, 3248.0, 4.0 * std::sqrt(report->covariances[0](0, 0)));
}

TEST(Verdict, NamesAPoseThatCouldNotBePlaced) {
  auto report = CalibrateRig(Observe(ExampleRig(1), ExamplePoses(), {}, 20));
  ASSERT_TRUE(report.ok()) << report.status().message();
  report->held_out[5].surprise = report->held_out[5].errors.squares[0] = INFINITY;
  report->held_out_total.Add(report->held_out[5].errors);
  const std::string said = Said(JudgeCalibration(*report));
  EXPECT_NE(said.find("REFUSED pose 5: no place of the board fits"), std::string::npos) << said;
  EXPECT_EQ(said.find("inf px"), std::string::npos) << said;
}

}  // namespace
}  // namespace stratalux::fit
