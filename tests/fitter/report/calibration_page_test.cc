// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/calibration_page.h"

#include <cmath>
#include <numeric>
#include <regex>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fitter/calibration/calibration_record.h"
#include "shared/units/angle.h"
#include "tests/fitter/calibration/synthetic_boards.h"
#include "tests/fitter/report/html_checks.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

const RigGeometry& Truth() {
  static const RigGeometry rig = ExampleRig(2);
  return rig;
}

const GeometryReport& Calibrated() {
  static const GeometryReport report = [] {
    auto poses = ExamplePoses();
    poses.resize(6);
    auto observations = Observe(Truth(), poses, {}, 21);
    observations.poses[3].corners[10].camera_px.x() += 5.0;  // will be left out
    auto calibrated = CalibrateRig(observations, {.distortion = DistortionModel::kK1K2});
    EXPECT_TRUE(calibrated.ok()) << calibrated.status().message();
    return std::move(calibrated).value();
  }();
  return report;
}

std::string Page(const CalibrationPage& page) {
  const auto html = RenderHtml(CalibrationReport(page));
  EXPECT_TRUE(html.ok()) << html.status().message();
  return html.ok() ? *html : "";
}

const ReportSection* SectionOf(const Report& report, const std::string& title) {
  for (const ReportSection& section : report.sections)
    if (section.title == title) return &section;
  return nullptr;
}

TEST(CalibrationPage, StandsAloneAndNests) {
  const std::string html = Page({{"s000001", "s000012"}, JudgeCalibration(Calibrated()), &Calibrated()});
  EXPECT_EQ(FirstBadlyNested(html), "");
  EXPECT_EQ(FetchedFromOutside(html), "");
  for (const char* bad : {"nan", "inf,", "inf'"}) EXPECT_THAT(html, Not(HasSubstr(bad)));
}

TEST(CalibrationPage, SaysFirstWhatIsWrongAndWhatToDo) {
  const std::string html =
      Page({{"s1"},
            {{Severity::kWarning, "few <poses>", "take more"}, {Severity::kRefusal, "fx is off", "tilt the board"}},
            &Calibrated()});
  EXPECT_THAT(html, HasSubstr("Refused: do not use this calibration"));
  EXPECT_THAT(html, HasSubstr("few &lt;poses&gt;"));
  EXPECT_LT(html.find("tilt the board"), html.find("take more"));
  EXPECT_LT(html.find("take more"), html.find("Residuals"));
  EXPECT_THAT(Page({{"s1"}, {}, &Calibrated()}), HasSubstr("Accepted: no fault was found"));
}

TEST(CalibrationPage, ExplainsACalibrationThatDidNotComeAbout) {
  const std::string html = Page({{}, {{Severity::kRefusal, "no charuco board of 10x7 squares", "show all of it"}}});
  EXPECT_THAT(html, HasSubstr("No calibration"));
  EXPECT_THAT(html, HasSubstr("no charuco board of 10x7 squares"));
  EXPECT_EQ(FirstBadlyNested(html), "");
}

// Arrows have the length of the residual in units of the scale's bar, which is a round number of pixels.
TEST(CalibrationPage, DrawsResidualsToTheScaleItNames) {
  GeometryReport report = Calibrated();
  // Nothing but one error of 0.3 px to the right, in one corner.
  for (size_t k = 0; k < report.used.poses.size(); ++k)
    for (CornerObservation& corner : report.used.poses[k].corners)
      corner.camera_px =
          *ProjectCorner(report.bundle.rig, 0, report.used.board, report.bundle.camera_from_board[k], corner.corner);
  report.used.poses[2].corners[5].camera_px.x() -= 0.3;
  const Report page = CalibrationReport({{"s1"}, {}, &report});
  const std::string svg = SectionOf(page, "Residuals")->drawings[0].svg;
  const std::regex line("<line x1='([^']*)' y1='([^']*)' x2='([^']*)' y2='([^']*)' stroke='hsl");
  double longest = 0.0;
  int lines = 0;
  for (std::sregex_iterator it(svg.begin(), svg.end(), line), end; it != end; ++it, ++lines)
    longest = std::max(longest, std::stod((*it)[3]) - std::stod((*it)[1]));
  const std::regex bar("<line x1='6' y1='[^']*' x2='([^']*)'");
  const std::regex name(">([0-9.e-]+) px</text>");
  std::smatch bar_match, name_match;
  ASSERT_TRUE(std::regex_search(svg, bar_match, bar) && std::regex_search(svg, name_match, name));
  const double px_per_drawn = std::stod(name_match[1]) / (std::stod(bar_match[1]) - 6.0);
  EXPECT_NEAR(longest * px_per_drawn, 0.3, 0.003);
  const int corners = report.training_total.counts[0];
  EXPECT_EQ(lines, corners + 2);  // and the head of the one that is long enough
}

TEST(CalibrationPage, CountsEachCornerOnceInTheCoverage) {
  const Report page = CalibrationReport({{"s1"}, {}, &Calibrated()});
  const std::string svg = SectionOf(page, "Where the boards were")->drawings[0].svg;
  const std::regex text("<text[^>]*>([0-9]+)</text>");
  int corners = 0;
  for (std::sregex_iterator it(svg.begin(), svg.end(), text), end; it != end; ++it) corners += std::stoi((*it)[1]);
  EXPECT_EQ(corners, Calibrated().corners);
}

TEST(CalibrationPage, ShowsTheProjectorThatMoved) {
  RigCalibration earlier = ToRecord(Calibrated(), std::nullopt, "calibration session s000099");
  Rigid3& pose = earlier.projectors[1].camera_from_projector;
  pose.rotation = pose.rotation * Eigen::Quaterniond(Eigen::AngleAxisd(RadFromDeg(0.5), Eigen::Vector3d::UnitX()));
  pose.translation_mm.x() += 4.0;
  const Report page = CalibrationReport({{"s1"}, {}, &Calibrated(), earlier});
  const ReportSection* section = SectionOf(page, "Before and after");
  ASSERT_NE(section, nullptr);
  const auto& rows = section->tables[0].rows;
  EXPECT_EQ(rows[0], (std::vector<std::string>{"moved, mm", "-", "0.00", "4.00"}));
  EXPECT_EQ(rows[1], (std::vector<std::string>{"turned", "-", "0.000°", "0.500°"}));
  // What did not change is off by nothing; the place by so many standard deviations of both calibrations together.
  EXPECT_EQ(rows[2][1], "+0.00 (+0.0 sd)");
  const double sd = std::sqrt(2.0 * Calibrated().covariances[2](12, 12));
  char expected[32];
  std::snprintf(expected, sizeof expected, "-4.000 (%+.1f sd)", -4.0 / sd);
  EXPECT_EQ(rows[2 + 12][3], expected);
}

TEST(CalibrationPage, ComparesNothingWithAnotherRig) {
  RigCalibration earlier = ToRecord(Calibrated(), std::nullopt, "x");
  earlier.projectors.pop_back();
  const Report page = CalibrationReport({{"s1"}, {}, &Calibrated(), earlier});
  EXPECT_TRUE(SectionOf(page, "Before and after")->tables.empty());
}

LightReport MeasuredLight() {
  LightReport light;
  light.sessions = {"s2"};
  light.dark.emplace();
  light.dark->offset_dn = Image<float>(600, 40, 1, 64.0F);
  light.dark->offset_dn(3, 3) = NAN;
  light.dark->read_noise_dn_map = light.dark->offset_dn;
  light.transfer.emplace();
  light.transfer->gain_e_per_dn = 4.0;
  light.transfer->read_noise_dn = 3.0;
  light.transfer->points = {{100.0, 34.0, 10}, {2000.0, 509.0, 10}};
  light.vignetting = {-0.2, 0.0};
  light.projectors.resize(2);
  light.projectors[0].name = "left <one>";
  light.projectors[0].response = {0.0, 0.1, 0.3, 0.6, 1.0};
  light.projectors[0].falloff = {-0.12, 0.02};
  light.projectors[0].white_dn_mm2_per_ms = {2.0, 4.0, 1.0};
  light.projectors[0].line.emplace();
  light.projectors[0].line->offset_px = {-1.0, 0.0, 1.0};
  light.projectors[0].line->light = {0.1, 0.9, 0.1};
  light.flats = {{"s3", 2, 20.0, 700.0, 0.05, 0.8, 0.004}};
  light.carried_over = {"black level: no session of kind dark"};
  return light;
}

TEST(CalibrationPage, ShowsTheLightThatWasMeasured) {
  const LightReport light = MeasuredLight();
  const RigCalibration record = ToRecord(Calibrated(), std::nullopt, "x");
  const Report page = CalibrationReport({{"s1"}, {}, nullptr, {}, light, record});
  EXPECT_EQ(page.banner->tone, Tone::kGood);  // of light alone
  EXPECT_THAT(page.banner->text, HasSubstr("stay as before"));
  const ReportSection* camera = SectionOf(page, "Light: the camera");
  ASSERT_NE(camera, nullptr);
  // The line of the photon transfer: read noise squared and signal over gain.
  EXPECT_DOUBLE_EQ(camera->plots[0].series[1].y[1], 9.0 + 500.0);
  for (const ReportImage& image : camera->images) EXPECT_LE(image.pixels.width(), 270);
  const ReportSection* projectors = SectionOf(page, "Light: the projectors");
  ASSERT_NE(projectors, nullptr);
  EXPECT_EQ(projectors->tables[0].rows[0][1], "0.500, 1, 0.250");
  EXPECT_EQ(projectors->tables[0].rows[1][1], "-");
  // The inverse is the response with its axes exchanged.
  EXPECT_EQ(projectors->plots[1].series[0].x, projectors->plots[0].series[0].y);
  const std::string html = Page({{"s1"}, {}, nullptr, {}, light, record});
  EXPECT_THAT(html, HasSubstr("left &lt;one&gt;"));
  EXPECT_THAT(html, HasSubstr("no session of kind dark"));
  EXPECT_THAT(html, Not(HasSubstr("nan")));
  EXPECT_EQ(FirstBadlyNested(html), "");
}

// A map falls to what the polynomial says at the picture's far corner.
TEST(CalibrationPage, DrawsFallOffOverThePicture) {
  const LightReport light = MeasuredLight();
  RigCalibration record = ToRecord(Calibrated(), std::nullopt, "x");
  Pinhole& m = record.projectors[0].model;
  m.cx = -0.5;
  m.cy = -0.5;  // the far corner lies at twice half the diagonal: 1 - 0.12 4 + 0.02 16
  const Report page = CalibrationReport({{"s1"}, {}, nullptr, {}, light, record});
  EXPECT_THAT(SectionOf(page, "Light: the projectors")->images[0].caption,
              HasSubstr("0.999 (light)"));  // the brightest 0.5 % aside
  EXPECT_THAT(SectionOf(page, "Light: the projectors")->images[0].caption, HasSubstr("0.820 (dark)"));
}

TEST(CalibrationPage, HasNoNumberWhereThereIsNone) {
  GeometryReport report = Calibrated();
  report.covariances.clear();
  for (PoseObservation& pose : report.used.poses)
    for (CornerObservation& corner : pose.corners) corner.projector_px[1].reset();
  report.training_total.counts[2] = report.held_out_total.counts[2] = report.epipolar.counts[2] = 0;
  report.coverage_map[2].assign(report.coverage_map[2].size(), 0);
  const std::string html = Page({{"s1"}, {}, &report});
  EXPECT_THAT(html, Not(HasSubstr("nan")));
  EXPECT_EQ(FirstBadlyNested(html), "");
}

}  // namespace
}  // namespace stratalux::fit
