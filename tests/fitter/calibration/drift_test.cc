// SPDX-License-Identifier: Apache-2.0
// A rig that no longer stands as it was calibrated, on codes computed from where it really stands.
#include "fitter/reconstruction/drift.h"

#include <cmath>
#include <random>

#include <gmock/gmock.h>

#include "fitter/reconstruction/triangulate.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

constexpr float kNoise_px = 0.15F;

RigCalibration Rig() {
  RigCalibration rig;
  rig.camera.cfa = Cfa::kMono;
  rig.camera.model = {160, 120, 370, 370, 79.5, 59.5, {}};
  const std::vector<Eigen::Vector3d> centres = {{-450, -60, 0}, {-180, -300, 20}, {200, 300, 20}, {430, 80, 0}};
  for (size_t p = 0; p < centres.size(); ++p) {
    ProjectorCalibration projector;
    projector.name = "projector " + std::to_string(p);
    projector.model = {1024, 768, 2690, 2690, 517, 374, {}};
    projector.camera_from_projector = LookAt(centres[p], {0, 4, 700});
    projector.white_dn_mm2_per_ms = {1, 1, 1};
    rig.projectors.push_back(projector);
  }
  return rig;
}

void Turn(ProjectorCalibration& projector, const Eigen::Vector3d& axis, double degrees) {
  projector.camera_from_projector.rotation =
      projector.camera_from_projector.rotation * Eigen::AngleAxisd(RadFromDeg(degrees), axis);
}

// A ball, lit by the rig as it stands; `displaced_px` moves all columns, as scattering does.
std::vector<DecodedMap> Decode(const RigCalibration& standing, double displaced_px, size_t projectors) {
  const int width = standing.camera.model.width, height = standing.camera.model.height;
  const Eigen::Vector3d centre(0, 0, 780);
  constexpr double kRadius = 95.0;
  std::mt19937 random(11);
  std::normal_distribution<float> noise(0.0F, kNoise_px);
  std::vector<DecodedMap> maps;
  for (size_t p = 0; p < projectors; ++p) {
    const float nan = std::nanf("");
    DecodedMap map{Image<float>(width, height, 1, nan), Image<float>(width, height, 1, nan),
                   Image<float>(width, height, 1, kNoise_px), Image<float>(width, height, 1, kNoise_px),
                   Image<uint8_t>(width, height, 1, static_cast<uint8_t>(DecodeReason::kUnlit))};
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const Eigen::Vector3d ray = standing.camera.model.Unproject(Eigen::Vector2d(x, y)).normalized();
        const double along = ray.dot(centre);
        const double squared = along * along - centre.squaredNorm() + kRadius * kRadius;
        if (squared < 0.0) continue;
        const Eigen::Vector3d point = ray * (along - std::sqrt(squared));
        const ProjectorCalibration& projector = standing.projectors[p];
        if ((point - centre).dot(projector.CentreInCamera() - point) < 0.0) continue;  // in its own shadow
        const auto at = projector.ProjectFromCamera(point);
        if (!at || !projector.model.Contains(*at)) continue;
        map.column(x, y) = static_cast<float>(at->x() + displaced_px) + noise(random);
        map.row(x, y) = static_cast<float>(at->y()) + noise(random);
        map.reason(x, y) = static_cast<uint8_t>(DecodeReason::kValid);
      }
    maps.push_back(std::move(map));
  }
  return maps;
}

enum class Axes { kBoth, kColumns, kRows };

DriftReport Check(const RigCalibration& standing, RigCalibration calibrated, double displaced_px = 0.0,
                  Axes axes = Axes::kBoth) {
  auto decoded = Decode(standing, displaced_px, calibrated.projectors.size());
  for (DecodedMap& map : decoded) {
    if (axes == Axes::kColumns)
      map.row = map.row_sigma = Image<float>(map.row.width(), map.row.height(), 1, std::nanf(""));
    if (axes == Axes::kRows)
      map.column = map.column_sigma = Image<float>(map.column.width(), map.column.height(), 1, std::nanf(""));
  }
  const auto shape = Triangulate(decoded, calibrated);
  EXPECT_TRUE(shape.ok()) << shape.status().message();
  auto report = CheckDrift(decoded, shape->surface, calibrated);
  EXPECT_TRUE(report.ok()) << report.status().message();
  return std::move(report).value();
}

TEST(Drift, ARigThatStandsAsCalibratedIsNotNamed) {
  const DriftReport report = Check(Rig(), Rig());
  EXPECT_EQ(report.warning, "");
  ASSERT_EQ(report.projectors.size(), 4U);
  for (const ProjectorDrift& drift : report.projectors) {
    EXPECT_GT(drift.points, 1000);
    EXPECT_LT(drift.shift_px, 0.05) << drift.projector;
    EXPECT_FALSE(drift.moved);
    // Both axes together, a little less for what the surface took up of it.
    EXPECT_NEAR(drift.expected_px, std::sqrt(2.0) * double{kNoise_px}, 1e-3);
    EXPECT_GT(drift.spread_px, 0.6 * drift.expected_px);
    EXPECT_LT(drift.spread_px, 1.3 * drift.expected_px);
  }
}

TEST(Drift, WhatScatteringDisplacesIsNoDrift) { EXPECT_EQ(Check(Rig(), Rig(), 0.3).warning, ""); }

class TurnedProjector : public ::testing::TestWithParam<std::tuple<int, int, double>> {};

TEST_P(TurnedProjector, IsNamedAlone) {
  const auto [projector, axis, degrees] = GetParam();
  RigCalibration standing = Rig();
  Turn(standing.projectors[static_cast<size_t>(projector)], Eigen::Vector3d::Unit(axis), degrees);
  const DriftReport report = Check(standing, Rig());
  for (const ProjectorDrift& drift : report.projectors)
    EXPECT_EQ(drift.moved, drift.projector == projector)
        << "projector " << drift.projector << ": " << drift.shift_px << " px";
  EXPECT_THAT(report.warning, HasSubstr("recalibration is due: the light of projector " + std::to_string(projector)));
  EXPECT_NEAR(report.projectors[static_cast<size_t>(projector)].turned_deg, std::abs(degrees), 0.1 * std::abs(degrees));
}

INSTANTIATE_TEST_SUITE_P(ByATenthOfADegreeAndMore, TurnedProjector,
                         ::testing::Combine(::testing::Range(0, 4), ::testing::Values(0, 1),
                                            ::testing::Values(-0.1, 0.2)));

TEST(Drift, ATurnAboutItsOwnAxisIsFoundToo) {
  RigCalibration standing = Rig();
  Turn(standing.projectors[2], Eigen::Vector3d::UnitZ(), 0.6);
  const DriftReport report = Check(standing, Rig());
  EXPECT_TRUE(report.projectors[2].moved);
  EXPECT_LT(std::hypot(report.projectors[2].shift_columns, report.projectors[2].shift_rows),
            report.projectors[2].shift_px);
}

TEST(Drift, ATurnedCameraDisplacesAll) {
  RigCalibration standing = Rig();
  // The rig frame is the camera's: all projectors turn about it together.
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(RadFromDeg(0.3), Eigen::Vector3d(1, 0.4, 0).normalized()));
  for (ProjectorCalibration& p : standing.projectors)
    p.camera_from_projector = Rigid3{turn, Eigen::Vector3d::Zero()} * p.camera_from_projector;
  const DriftReport report = Check(standing, Rig());
  EXPECT_THAT(report.warning, HasSubstr("recalibration is due"));
}

TEST(Drift, OneProjectorAloneShowsWhatLiesAcrossItsEpipolarLines) {
  RigCalibration standing = Rig(), calibrated = Rig();
  standing.projectors.resize(1);
  calibrated.projectors.resize(1);
  EXPECT_THAT(Check(standing, calibrated).warning,
              StartsWith("not judged: what moves the light of projector 0 along its epipolar lines"));
  Turn(standing.projectors[0], Eigen::Vector3d::UnitX(), 0.15);  // moves its light across
  const DriftReport report = Check(standing, calibrated);
  EXPECT_TRUE(report.moved());
  EXPECT_THAT(report.warning, HasSubstr("recalibration is due: the light of projector 0"));
}

TEST(Drift, IsJudgedByTheAxisThatWasCaptured) {
  for (const Axes axes : {Axes::kColumns, Axes::kRows}) {
    const bool columns = axes == Axes::kColumns;
    const DriftReport still = Check(Rig(), Rig(), 0.0, axes);
    EXPECT_EQ(still.warning, "");
    for (const ProjectorDrift& drift : still.projectors) {
      EXPECT_GT(drift.points, 1000) << drift.projector;
      EXPECT_LT(drift.shift_px, 0.05) << drift.projector;
      EXPECT_NEAR(drift.expected_px, double{kNoise_px}, 1e-3) << "of one axis";
      EXPECT_LT(drift.spread_px, 1.3 * drift.expected_px) << drift.projector;
    }
    // About the axis that moves the captured coordinate, of a projector whose baseline lies along it.
    const size_t turned = columns ? 0 : 1;
    RigCalibration standing = Rig();
    Turn(standing.projectors[turned], Eigen::Vector3d::Unit(columns ? 1 : 0), 0.1);
    const DriftReport report = Check(standing, Rig(), 0.0, axes);
    const ProjectorDrift& drift = report.projectors[turned];
    EXPECT_TRUE(drift.moved) << drift.shift_px;
    EXPECT_NEAR(drift.turned_deg, 0.1, 0.015);
    EXPECT_EQ(columns ? drift.shift_rows : drift.shift_columns, 0.0);
    EXPECT_GT(std::abs(columns ? drift.shift_columns : drift.shift_rows), 3.0);
    EXPECT_THAT(report.warning, StartsWith("recalibration is due: the light of projector " + std::to_string(turned)));
  }
}

// Its columns agree with whatever depth they give.
TEST(Drift, OneAxisOfOneProjectorIsNotJudged) {
  RigCalibration standing = Rig(), calibrated = Rig();
  standing.projectors.resize(1);
  calibrated.projectors.resize(1);
  Turn(standing.projectors[0], Eigen::Vector3d::UnitY(), 0.3);
  const DriftReport report = Check(standing, calibrated, 0.0, Axes::kColumns);
  EXPECT_FALSE(report.projectors[0].judged());
  EXPECT_THAT(report.warning, StartsWith("not judged: projector 0 (0 points)"));
  EXPECT_THAT(report.warning, HasSubstr("one axis alone"));
  EXPECT_THAT(Describe(report),
              StartsWith("Whether the projectors' light falls where the calibration says is not known"));
}

TEST(Drift, TheReportClaimsNoMoreThanWasJudged) {
  const std::string well = "The projectors' light falls where the calibration says";
  DriftReport report;
  EXPECT_THAT(Describe(report), Not(HasSubstr(well))) << "of a true surface nothing is judged";
  report.projectors.push_back({.projector = 0, .points = 900, .shift_px = 0.02});
  EXPECT_EQ(Describe(report), well);
  // As a fit of before has it, whose warning did not say so.
  report.projectors.push_back({.projector = 1, .points = 31});
  EXPECT_THAT(Describe(report), StartsWith(well + ", as far as it is judged (not judged: projector 1 (31 points)"));
  report.projectors.erase(report.projectors.begin());
  EXPECT_THAT(Describe(report), Not(HasSubstr(well + ",")));
  EXPECT_THAT(Describe(report), HasSubstr("is not known: not judged: projector 1 (31 points)"));
}

TEST(Drift, TooFewPointsAreNotJudged) {
  auto decoded = Decode(Rig(), 0.0, 4);
  auto shape = Triangulate(decoded, Rig());
  ASSERT_TRUE(shape.ok());
  for (DecodedMap& map : decoded)
    for (int j = 0; j < map.reason.height(); ++j)
      for (int i = 0; i < map.reason.width(); ++i)
        if (j != 60) map.reason(i, j) = static_cast<uint8_t>(DecodeReason::kUnlit);
  const auto report = CheckDrift(decoded, shape->surface, Rig());
  ASSERT_TRUE(report.ok());
  EXPECT_THAT(report->warning, StartsWith("not judged: projector 0 ("));
  EXPECT_FALSE(report->projectors[0].judged());
  const std::vector<int> numbers = {7, 2, 1, 0};
  const auto numbered = CheckDrift(decoded, shape->surface, Rig(), {}, numbers);
  ASSERT_TRUE(numbered.ok());
  EXPECT_THAT(numbered->warning, StartsWith("not judged: projector 7 ("));
  const auto short_of_one = CheckDrift(decoded, shape->surface, Rig(), {}, std::span(numbers).first(3));
  EXPECT_EQ(short_of_one.status().code(), StatusCode::kUsage);
}

TEST(Drift, MapsOfAnotherSizeAreRefused) {
  const auto decoded = Decode(Rig(), 0.0, 4);
  SurfaceMap surface;
  EXPECT_EQ(CheckDrift(decoded, surface, Rig()).status().code(), StatusCode::kUsage);
  RigCalibration three = Rig();
  three.projectors.resize(3);
  EXPECT_EQ(CheckDrift(decoded, surface, three).status().code(), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
