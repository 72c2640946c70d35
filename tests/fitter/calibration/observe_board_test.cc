// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/observe_board.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "shared/pattern/pattern.h"

namespace stratalux::fit {
namespace {

constexpr int kDrawingWidth = 480, kDrawingHeight = 400;
const BoardDescription kBoard{BoardKind::kChess, 8, 7, 10.0, 0.0};

// Where a corner is drawn: a turned board, seen along its normal.
struct Drawing {
  double pixels_per_mm = 4.2, turn_rad = 0.15;
  Eigen::Vector2d first_px{130.0, 90.0};
  double exposure = 1.0;

  [[nodiscard]] Eigen::Vector2d PixelOf(const Eigen::Vector2d& mm) const {
    return first_px + pixels_per_mm * (Eigen::Rotation2D<double>(turn_rad) * mm);
  }
  [[nodiscard]] Eigen::Vector2d BoardMm(const Eigen::Vector2d& pixel) const {
    return Eigen::Rotation2D<double>(-turn_rad) * (pixel - first_px) / pixels_per_mm;
  }
};

double Albedo(const Eigen::Vector2d& mm) {
  const int c = static_cast<int>(std::floor(mm.x() / kBoard.square_mm)) + 1;
  const int r = static_cast<int>(std::floor(mm.y() / kBoard.square_mm)) + 1;
  const bool inside = c >= 0 && r >= 0 && c < kBoard.columns && r < kBoard.rows;
  return inside && (c + r) % 2 == 0 ? 0.05 : 0.9;
}

// Light of a pixel's box, with noise.
Image<float> Draw(const Drawing& drawing, uint64_t seed) {
  constexpr int kSide = 5;
  Image<float> image(kDrawingWidth, kDrawingHeight);
  Random random(seed);
  for (int y = 0; y < kDrawingHeight; ++y)
    for (int x = 0; x < kDrawingWidth; ++x) {
      double sum = 0.0;
      for (int j = 0; j < kSide; ++j)
        for (int i = 0; i < kSide; ++i)
          sum += Albedo(drawing.BoardMm({x + (i + 0.5) / kSide - 0.5, y + (j + 0.5) / kSide - 0.5}));
      image(x, y) = static_cast<float>(std::min(3000.0 * drawing.exposure * sum / (kSide * kSide), 4031.0) +
                                       10.0 * random.Normal());
    }
  return image;
}

ProjectorPictures Pictures(const Drawing& before, const Drawing& after) {
  ProjectorPictures pictures{2, Draw(before, 1), Draw(after, 2), Image<uint8_t>(kDrawingWidth, kDrawingHeight)};
  for (size_t i = 0; i < pictures.saturated.size(); ++i)
    pictures.saturated.pixels()[i] = pictures.white_light.pixels()[i] > 3950.0F;
  return pictures;
}

double WorstDistance(const std::vector<BoardCorner>& corners, const Drawing& drawing) {
  double worst = 0.0;
  for (const BoardCorner& corner : corners) {
    double least = INFINITY;  // a chessboard's numbering may start at either end
    for (int id = 0; id < kBoard.corners(); ++id)
      least = std::min(least, (drawing.PixelOf(kBoard.CornerMm(id)) - corner.pixel_px).norm());
    worst = std::max(worst, least);
  }
  return worst;
}

// Columns and rows of a projector of 256 x 256 that looks straight at the picture.
Eigen::Vector2d ProjectorPixel(const Eigen::Vector2d& camera_px) {
  return {0.45 * camera_px.x() + 0.02 * camera_px.y() + 8.3, -0.01 * camera_px.x() + 0.5 * camera_px.y() + 20.4};
}

enum class Inverted { kNo, kColumns, kBoth };

DecodedMap Decoded(Inverted inverted) {
  DecodedMap map{Image<float>(kDrawingWidth, kDrawingHeight), Image<float>(kDrawingWidth, kDrawingHeight),
                 Image<float>(kDrawingWidth, kDrawingHeight, 1, 0.29F),
                 Image<float>(kDrawingWidth, kDrawingHeight, 1, 0.29F), Image<uint8_t>(kDrawingWidth, kDrawingHeight)};
  auto coded = [](double position, bool invert) {
    auto cell = static_cast<unsigned>(std::lround(position));
    if (invert) cell = BinaryFromGray(~GrayFromBinary(cell) & 0xFFU);
    return static_cast<float>(cell);
  };
  for (int y = 0; y < kDrawingHeight; ++y)
    for (int x = 0; x < kDrawingWidth; ++x) {
      const Eigen::Vector2d at = ProjectorPixel(Eigen::Vector2d(x, y));
      map.column(x, y) = coded(at.x(), inverted != Inverted::kNo);
      map.row(x, y) = coded(at.y(), inverted == Inverted::kBoth);
    }
  return map;
}

TEST(FindStillBoard, FindsCornersToATenthOfAPixel) {
  const Drawing drawing;
  const auto corners = FindStillBoard({Pictures(drawing, drawing)}, kBoard);
  ASSERT_TRUE(corners.ok()) << corners.status().message();
  EXPECT_EQ(corners->size(), static_cast<size_t>(kBoard.corners()));
  EXPECT_LT(WorstDistance(*corners, drawing), 0.1);
}

TEST(FindStillBoard, SaysThatThereIsNoBoard) {
  ProjectorPictures empty{0, Image<float>(kDrawingWidth, kDrawingHeight, 1, 900.0F),
                          Image<float>(kDrawingWidth, kDrawingHeight, 1, 900.0F),
                          Image<uint8_t>(kDrawingWidth, kDrawingHeight)};
  const auto corners = FindStillBoard({empty}, kBoard);
  EXPECT_EQ(corners.status().code(), StatusCode::kNotFound);
  EXPECT_NE(corners.status().message().find("8x7 squares"), std::string::npos) << corners.status().message();
  // Another number of squares is no such board either.
  BoardDescription other = kBoard;
  other.columns = 12;
  EXPECT_EQ(FindStillBoard({Pictures({}, {})}, other).status().code(), StatusCode::kNotFound);
}

TEST(FindStillBoard, NamesTheProjectorWhoseLightSaturates) {
  Drawing bright;
  bright.exposure = 1.6;
  const auto corners = FindStillBoard({Pictures(bright, bright)}, kBoard);
  ASSERT_FALSE(corners.ok());
  EXPECT_NE(corners.status().message().find("saturated"), std::string::npos) << corners.status().message();
  EXPECT_NE(corners.status().message().find("projector 2"), std::string::npos) << corners.status().message();
}

TEST(FindStillBoard, SeesHalfAPixelOfMotionDuringThePose) {
  Drawing after;
  after.first_px.x() += 0.5;
  const auto corners = FindStillBoard({Pictures({}, after)}, kBoard);
  ASSERT_FALSE(corners.ok());
  EXPECT_NE(corners.status().message().find("moved by 0."), std::string::npos) << corners.status().message();
  EXPECT_NE(corners.status().message().find("after its codes"), std::string::npos) << corners.status().message();
  after.first_px = {150.0, 100.0};
  EXPECT_NE(FindStillBoard({Pictures({}, after)}, kBoard).status().message().find("moved by"), std::string::npos);
}

TEST(LookUpCorners, GivesPlacesToATenthOfAPixelOutOfWholeColumns) {
  const Drawing drawing;
  std::vector<BoardCorner> corners;
  for (int id = 0; id < kBoard.corners(); ++id) corners.push_back({id, drawing.PixelOf(kBoard.CornerMm(id))});
  const auto seen = LookUpCorners(Decoded(Inverted::kNo), corners, {256, 256});
  ASSERT_TRUE(seen.ok() && seen->seen);
  for (size_t i = 0; i < corners.size(); ++i)
    EXPECT_LT((*seen->column_row[i] - ProjectorPixel(corners[i].pixel_px)).norm(), 0.12);
}

TEST(LookUpCorners, SaysWhichCodesComeInverted) {
  const Drawing drawing;
  std::vector<BoardCorner> corners;
  for (int id = 0; id < kBoard.corners(); ++id) corners.push_back({id, drawing.PixelOf(kBoard.CornerMm(id))});
  const auto columns = LookUpCorners(Decoded(Inverted::kColumns), corners, {256, 256});
  ASSERT_FALSE(columns.ok());
  EXPECT_NE(columns.status().message().find("the column codes come inverted"), std::string::npos)
      << columns.status().message();
  const auto both = LookUpCorners(Decoded(Inverted::kBoth), corners, {256, 256});
  ASSERT_FALSE(both.ok());
  EXPECT_NE(both.status().message().find("column and row"), std::string::npos) << both.status().message();
}

TEST(LookUpCorners, LetsAProjectorThatLightsTooLittleSitOut) {
  const Drawing drawing;
  std::vector<BoardCorner> corners;
  for (int id = 0; id < kBoard.corners(); ++id) corners.push_back({id, drawing.PixelOf(kBoard.CornerMm(id))});
  DecodedMap map = Decoded(Inverted::kNo);
  std::fill(map.reason.pixels().begin(), map.reason.pixels().end(), static_cast<uint8_t>(DecodeReason::kUnlit));
  const auto seen = LookUpCorners(map, corners, {256, 256});
  ASSERT_TRUE(seen.ok());
  EXPECT_FALSE(seen->seen);
}

TEST(BoardLight, BringsTheMosaicsColoursToOneLevel) {
  Image<uint16_t> lit(8, 8);
  const Image<float> dark(8, 8, 1, 64.0F);
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x)
      lit(x, y) = static_cast<uint16_t>(64 + std::array{700, 1000, 500}[CfaColour(Cfa::kRggb, x, y)]);
  const Image<float> light = BoardLight(lit, dark, Cfa::kRggb);
  for (float v : light.pixels()) EXPECT_NEAR(v, 1000.0F, 1e-3);
}

}  // namespace
}  // namespace stratalux::fit
