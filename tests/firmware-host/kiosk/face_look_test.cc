// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/face_look.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "tests/firmware-host/kiosk/lit_rectangle.h"
#include "tests/firmware-host/session/small_station.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

TEST(FaceLook, TheBoxIsThatOfTheLargestPart) {
  Image<uint16_t> white = LitRectangle(80, 48, 240, 216, 1000);
  for (int y = 0; y < 40; ++y)
    for (int x = 280; x < 320; ++x) white(x, y) = 1000;  // something that shines in the corner
  const std::vector<PreScan> scans = {{white, kDarkPicture}};
  const auto foreground = ForegroundOf(scans, 3.0);
  ASSERT_TRUE(foreground);
  EXPECT_EQ(foreground->Count(), (160 / 8) * (168 / 8));
  EXPECT_EQ(BoxOf(*foreground), (FaceBox{250, 200, 750, 900}));
}

TEST(FaceLook, WhatAnyProjectorLightsIsForeground) {
  const Image<uint16_t> left = LitRectangle(80, 48, 160, 216, 1000), right = LitRectangle(160, 48, 240, 216, 300);
  const std::vector<PreScan> scans = {{left, kDarkPicture}, {right, kDarkPicture}};
  EXPECT_EQ(BoxOf(*ForegroundOf(scans, 3.0)), (FaceBox{250, 200, 750, 900}));
}

TEST(FaceLook, NobodyIsNoFace) {
  const std::vector<PreScan> scans = {{kDarkPicture, kDarkPicture}};
  EXPECT_FALSE(ForegroundOf(scans, 3.0));
  const Image<uint16_t> speck = LitRectangle(80, 48, 88, 56, 1000);
  const std::vector<PreScan> little = {{speck, kDarkPicture}};
  EXPECT_FALSE(ForegroundOf(little, 3.0));
}

TEST(FaceLook, CoverageIsTheShareOfWhatWasThere) {
  const Image<uint16_t> before = LitRectangle(80, 48, 240, 216, 1000), turned = LitRectangle(80, 48, 160, 216, 1000);
  const std::vector<PreScan> first = {{before, kDarkPicture}}, then = {{turned, kDarkPicture}};
  EXPECT_EQ(CoveragePermille(*ForegroundOf(first, 3.0), *ForegroundOf(then, 3.0)), 500);
  EXPECT_EQ(CoveragePermille(*ForegroundOf(then, 3.0), *ForegroundOf(first, 3.0)), 1000);
}

class FaceDistance : public ScratchFolderTest {};

// By the simulation's own depth. A stripe is 1/32 of the projector; the median over the blocks evens that out.
TEST_F(FaceDistance, IsTheMedianOfTheDepth) {
  StationOptions options = SmallStation(folder_);
  options.config.camera.width = 348;
  options.config.camera.height = 260;
  options.config.plan.projector_width = 256;
  options.config.plan.projector_height = 192;
  for (const char* scene : {"plane", "sphere", "head"}) {
    Simulate(options, scene);
    StopToken stop;
    Logger logger(LogLevel::kError);
    const auto opened = CaptureStation::Open(options, stop, logger);
    ASSERT_TRUE(opened.ok()) << opened.status().message();
    CaptureStation& station = **opened;
    const auto taken = station.TakePreScan(options.config.plan, {}, std::chrono::seconds(100));
    ASSERT_TRUE(taken.ok()) << taken.status().message();
    std::vector<PreScan> scans;
    for (size_t i = 0; i < taken->shots.size(); i += 2)
      scans.push_back({taken->shots[i].pixels, taken->shots[i + 1].pixels});
    const auto foreground = ForegroundOf(scans, 3.0);
    ASSERT_TRUE(foreground) << scene;
    const CapturePlan plan = *BuildPlan(options.config.plan);
    const auto code = CoarseCode(plan, 0, 5);
    ASSERT_EQ(code.size(), 5U);
    std::vector<Shot> shots;
    for (const auto& [bit, inverse] : code)
      for (const Pattern& pattern : {bit, inverse}) {
        auto shot = station.SnapPattern(0, pattern, 16.0);
        ASSERT_TRUE(shot.ok()) << shot.status().message();
        shots.push_back(std::move(*shot));
      }
    std::vector<CodeBit> bits;
    for (size_t i = 0; i < shots.size(); i += 2) bits.push_back({shots[i].pixels, shots[i + 1].pixels});
    const auto distance =
        MedianDistanceMm(*foreground, bits, code.front().first.bits, *station.Calibration("exact"), 0);
    ASSERT_TRUE(distance) << scene;
    const auto truth = station.rig().simulation->Truth(plan);
    ASSERT_TRUE(truth.ok());
    const auto depth = std::find_if(truth->begin(), truth->end(), [](const TruthMap& m) { return m.name == "depth"; });
    ASSERT_TRUE(depth != truth->end());
    std::vector<float> depths;
    for (int y = 0; y < depth->map.height(); ++y)
      for (int x = 0; x < depth->map.width(); ++x)
        if (std::isfinite(depth->map(x, y))) depths.push_back(depth->map(x, y));
    std::nth_element(depths.begin(), depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2), depths.end());
    const double median = depths[depths.size() / 2];
    const FaceBox box = BoxOf(*foreground);
    std::printf("%s: %.0f mm, truly %.0f; box %d %d %d %d\n", scene, *distance, median, box.left, box.top, box.right,
                box.bottom);
    EXPECT_NEAR(*distance, median, 0.03 * median) << scene;
  }
}

// Whatever code a visitor is shown, the look at the distance asks for patterns that a memory holds for boards.
TEST(FaceLook, CoarseCodeIsTheBoardsWhateverTheVisitorsIs) {
  PlanOptions options;
  options.kind = SessionKind::kCalibration;
  const auto boards = CoarseCode(*BuildPlan(options), 0, 5);
  ASSERT_EQ(boards.size(), 5U);
  options.kind = SessionKind::kVisitor;
  for (const ColumnCode code :
       {ColumnCode::kGray, ColumnCode::kXor2, ColumnCode::kXor4, ColumnCode::kMinStripe, ColumnCode::kMicroPhase}) {
    options.code = code;
    EXPECT_EQ(CoarseCode(*BuildPlan(options), 0, 5), boards) << ToString(code);
  }
}

}  // namespace
}  // namespace stratalux::rig
