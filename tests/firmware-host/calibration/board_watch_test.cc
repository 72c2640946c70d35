// SPDX-License-Identifier: Apache-2.0
// What the rig says of a board pose while it captures it, on boards whose place is known.
#include "firmware-host/calibration/board_watch.h"

#include <cmath>
#include <functional>
#include <random>

#include <gmock/gmock.h>

#include "firmware-host/calibration/instructions.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr int kWidth = 320, kHeight = 240, kColumns = 256, kRows = 192;

// A board of squares in a part of the picture, before nothing; the projector's picture lies over the camera's.
struct World {
  double left = 0.25, right = 0.75, top = 0.25, bottom = 0.75;  // of the board, shares of the picture
  double white_dn = 1500.0, noise_dn = 4.0;
  double moved_px = 0.0;  // of the board, from the 20th frame of each projector on
  bool blurred = false;   // codes without contrast

  [[nodiscard]] double Albedo(double x, double y) const {
    const double u = x / kWidth, v = y / kHeight;
    if (u < left || u >= right || v < top || v >= bottom) return 0.0;
    return (static_cast<int>(x / 14.0) + static_cast<int>(y / 14.0)) % 2 == 0 ? 0.9 : 0.05;
  }
};

BoardWatchOptions Options(int projectors = 2) {
  BoardWatchOptions options;
  options.projectors = projectors;
  options.projector_width = kColumns;
  options.projector_height = kRows;
  return options;
}

std::vector<Pattern> PosePatterns() {
  std::vector<Pattern> patterns = {{.kind = PatternKind::kWhite}, {.kind = PatternKind::kBlack}};
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    const int bits = GrayBits(axis == PatternAxis::kColumns ? kColumns : kRows);
    for (int bit = 0; bit < bits; ++bit)
      for (const bool inverse : {false, true})
        patterns.push_back({.kind = PatternKind::kGray, .axis = axis, .bit = bit, .bits = bits, .inverse = inverse});
  }
  return patterns;
}

Image<uint16_t> Shoot(const World& world, const Pattern& pattern, int number, std::mt19937& random) {
  std::normal_distribution<double> noise(0.0, world.noise_dn);
  Image<uint16_t> image(kWidth, kHeight);
  const double move = number >= 20 ? world.moved_px : 0.0;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const double intensity = world.blurred && pattern.kind == PatternKind::kGray
                                   ? 0.5
                                   : pattern.Intensity(x * kColumns / kWidth, y * kRows / kHeight);
      const double level = 64.0 + world.white_dn * world.Albedo(x + move, y) * intensity + noise(random);
      image(x, y) = static_cast<uint16_t>(std::clamp(level, 0.0, 4095.0));
    }
  return image;
}

BoardSighting Watch(const World& world, int projectors = 2, int dark_projector = -1) {
  BoardWatch watch(Options(projectors));
  std::mt19937 random(5);
  const auto patterns = PosePatterns();
  for (int p = 0; p < projectors; ++p)
    for (size_t k = 0; k < patterns.size(); ++k) {
      FrameRecord record;
      record.projector = p;
      record.pattern = patterns[k];
      const Pattern shown = p == dark_projector ? Pattern{.kind = PatternKind::kBlack} : patterns[k];
      watch.OnFrame(record, Shoot(world, shown, static_cast<int>(k), random));
    }
  return watch.Judge();
}

TEST(BoardWatch, CoversTheCellsThatTheBoardCovers) {
  const BoardSighting sighting = Watch({});
  EXPECT_THAT(sighting.faults, IsEmpty());
  EXPECT_THAT(sighting.notes, IsEmpty());
  ASSERT_THAT(sighting.projectors, SizeIs(2));
  // The middle half each way: 4 of 8 columns; 3 of 6 rows, of which the board's edge cuts the outer ones in half.
  for (const CoverageMap& map : {sighting.camera, sighting.projectors[0], sighting.projectors[1]}) {
    EXPECT_EQ(map.RowText(0), "........");
    EXPECT_EQ(map.RowText(2), "..####..");
    EXPECT_EQ(map.RowText(3), "..####..");
    EXPECT_EQ(map.RowText(5), "........");
  }
}

TEST(BoardWatch, AddsUpOverPoses) {
  CoverageMap all = Watch({}).camera;
  const double one = all.Share();
  all.Add(Watch({.left = 0.5, .right = 1.0, .top = 0.5, .bottom = 1.0}).camera);
  EXPECT_GT(all.Share(), one);
  EXPECT_TRUE(all.Covers(CoverageMap::CellAt(0.99, 0.99)));
  EXPECT_FALSE(all.Covers(CoverageMap::CellAt(0.01, 0.01)));
}

TEST(BoardWatch, SaysThatNothingIsLit) {
  const BoardSighting sighting = Watch({.white_dn = 0.0});
  ASSERT_THAT(sighting.faults, SizeIs(1));
  EXPECT_THAT(sighting.faults[0].what, HasSubstr("nothing is lit"));
  EXPECT_FALSE(sighting.faults[0].by_chance);
  EXPECT_EQ(sighting.camera.Share(), 0.0);
}

TEST(BoardWatch, AProjectorThatMissesTheBoardIsANoteAndNoFault) {
  const BoardSighting sighting = Watch({}, 2, 1);
  EXPECT_THAT(sighting.faults, IsEmpty());
  ASSERT_THAT(sighting.notes, SizeIs(1));
  EXPECT_THAT(sighting.notes[0], HasSubstr("projector 1"));
  EXPECT_EQ(sighting.projectors[1].Share(), 0.0);
}

TEST(BoardWatch, ASaturatedBoardIsToldWhichExposureToTry) {
  const BoardSighting sighting = Watch({.white_dn = 6000.0});
  ASSERT_THAT(sighting.faults, SizeIs(2));
  EXPECT_THAT(sighting.faults[0].what, HasSubstr("projector 0 lights is saturated"));
  EXPECT_THAT(sighting.faults[0].remedy, HasSubstr("--exposure 8"));
  EXPECT_FALSE(sighting.faults[0].by_chance);
}

TEST(BoardWatch, SeesABoardThatMovedByTwoPixels) {
  const BoardSighting sighting = Watch({.moved_px = 2.0});
  ASSERT_THAT(sighting.faults, SizeIs(2));
  EXPECT_THAT(sighting.faults[0].what, HasSubstr("moved"));
  EXPECT_TRUE(sighting.faults[0].by_chance);
}

TEST(BoardWatch, SeesCodesWithoutContrast) {
  const BoardSighting sighting = Watch({.blurred = true});
  ASSERT_FALSE(sighting.faults.empty());
  EXPECT_THAT(sighting.faults[0].what, HasSubstr("cannot be read"));
}

TEST(BoardWatch, AShotAgainReplacesTheDoubtfulOne) {
  BoardWatch watch(Options(1));
  std::mt19937 random(6);
  const auto patterns = PosePatterns();
  for (size_t k = 0; k < patterns.size(); ++k) {
    FrameRecord record;
    record.pattern = patterns[k];
    record.projector = 0;
    record.level_check = LevelCheck::kFailed;
    watch.OnFrame(record, Shoot({.white_dn = 9000.0}, patterns[k], 0, random));
    record.level_check = LevelCheck::kPassed;
    watch.OnFrame(record, Shoot({}, patterns[k], 0, random));
  }
  EXPECT_THAT(watch.Judge().faults, IsEmpty());
}

TEST(PoseInstruction, LeadsThroughTwelvePosesAndOn) {
  for (int pose = 0; pose < 2 * kAdvisedPoses; ++pose) EXPECT_FALSE(PoseInstruction(pose).empty());
  EXPECT_NE(PoseInstruction(0), PoseInstruction(kAdvisedPoses));
  EXPECT_TRUE(LightInstruction(SessionKind::kVisitor).empty());
  EXPECT_THAT(LightInstruction(SessionKind::kFlat, -1), HasSubstr("facing the camera"));
  EXPECT_THAT(LightInstruction(SessionKind::kFlat, 1), HasSubstr("nearer"));
  EXPECT_THAT(LightInstruction(SessionKind::kFlat, 2), HasSubstr("farther"));
}

}  // namespace
}  // namespace stratalux::rig
