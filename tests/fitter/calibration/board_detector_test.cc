// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/board_detector.h"

#include <Eigen/Geometry>
#include <cmath>

#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/aruco_markers.h"
#include "fitter/calibration/observe_board.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 520, kHeight = 400;
constexpr double kPixelsPerMm = 2.0, kTurn_rad = 0.1;
const Eigen::Vector2d kFirst_px{100.0, 60.0};  // of corner 0

Eigen::Vector2d PixelOf(const Eigen::Vector2d& mm) {
  return kFirst_px + kPixelsPerMm * (Eigen::Rotation2D<double>(kTurn_rad) * mm);
}

// The first square of a board is black, the white ones hold the markers in turn, row by row.
double Albedo(const BoardDescription& board, const Eigen::Vector2d& mm) {
  constexpr double kBlack = 0.05, kWhite = 0.9;
  const Eigen::Vector2d square = mm / board.square_mm + Eigen::Vector2d::Ones();
  const int c = static_cast<int>(std::floor(square.x())), r = static_cast<int>(std::floor(square.y()));
  if (c < 0 || r < 0 || c >= board.columns || r >= board.rows) return kWhite;
  if ((c + r) % 2 == 0) return kBlack;
  int marker = 0;
  for (int j = 0; j < board.rows; ++j)
    for (int i = 0; i < board.columns; ++i) marker += (i + j) % 2 == 1 && (j < r || (j == r && i < c)) ? 1 : 0;
  const double side = board.marker_mm / board.square_mm;
  const Eigen::Vector2d inside = ((square - Eigen::Vector2d(c, r)).array() - 0.5 * (1.0 - side)) / side;
  if (inside.minCoeff() < 0.0 || inside.maxCoeff() >= 1.0) return kWhite;
  const Eigen::Vector2d cell = inside * (rig::kMarkerCells + 2);
  return rig::MarkerBit(marker, static_cast<int>(cell.x()), static_cast<int>(cell.y())) ? kWhite : kBlack;
}

Image<float> Draw(const BoardDescription& board) {
  constexpr int kSide = 4;
  Image<float> image(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      double sum = 0.0;
      for (int j = 0; j < kSide; ++j)
        for (int i = 0; i < kSide; ++i) {
          const Eigen::Vector2d pixel(x + (i + 0.5) / kSide - 0.5, y + (j + 0.5) / kSide - 0.5);
          sum += Albedo(board, Eigen::Rotation2D<double>(-kTurn_rad) * (pixel - kFirst_px) / kPixelsPerMm);
        }
      image(x, y) = static_cast<float>(3000.0 * sum / (kSide * kSide));
    }
  return image;
}

// OpenCV's boards of an even number of rows began with a white square before 4.6: what is printed must not depend on
// the release of Debian that reads it.
TEST(BoardDetector, NumbersTheCornersOfACharucoBoardWhateverTheParityOfItsRows) {
  for (const auto& [columns, rows] : {std::pair(10, 7), std::pair(9, 7), std::pair(9, 6), std::pair(8, 6)}) {
    SCOPED_TRACE(std::to_string(columns) + "x" + std::to_string(rows));
    const BoardDescription board{BoardKind::kCharuco, columns, rows, 20.0, 15.0};
    const Image<float> picture = Draw(board);
    const auto corners = FindBoard(picture.view(), board);
    ASSERT_TRUE(corners.ok()) << corners.status().message();
    EXPECT_EQ(corners.value().size(), static_cast<size_t>(board.corners()));
    for (const BoardCorner& corner : corners.value())
      EXPECT_LT((corner.pixel_px - PixelOf(board.CornerMm(corner.corner))).norm(), 0.15) << "corner " << corner.corner;
  }
}

TEST(BoardDetector, SaysWhatItLookedForWhereThereIsNoMarker) {
  const BoardDescription board{BoardKind::kCharuco, 10, 7, 20.0, 15.0};
  Image<float> grey(kWidth, kHeight);
  for (float& pixel : grey.pixels()) pixel = 1000.0F;
  const auto corners = FindBoard(grey.view(), board);
  ASSERT_FALSE(corners.ok());
  EXPECT_EQ(corners.status().code(), StatusCode::kNotFound);
  EXPECT_NE(corners.status().message().find("charuco board of 10x7 squares"), std::string::npos);
}

// Half of a small board's corners place no board: such a pose would end the whole calibration.
TEST(FindStillBoard, RefusesAPoseOfFewerCornersThanPlaceABoard) {
  const BoardDescription board{BoardKind::kCharuco, 5, 3, 20.0, 15.0};
  ProjectorPictures pictures{0, Draw(board), {}, Image<uint8_t>(kWidth, kHeight)};
  const auto whole = FindStillBoard({pictures}, board);
  ASSERT_TRUE(whole.ok()) << whole.status().message();
  EXPECT_EQ(whole->size(), 8U);
  // A sheet of paper on its last two columns.
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      if ((Eigen::Rotation2D<double>(-kTurn_rad) * (Eigen::Vector2d(x, y) - kFirst_px)).x() > 2.0 * 20.0 * kPixelsPerMm)
        pictures.white_light(x, y) = 2700.0F;
  ASSERT_EQ(FindBoard(pictures.white_light.view(), board)->size(), 4U);
  const auto part = FindStillBoard({pictures}, board);
  ASSERT_FALSE(part.ok());
  EXPECT_EQ(part.status().code(), StatusCode::kNotFound);
  EXPECT_NE(part.status().message().find("only 4 of the board's 8 corners"), std::string::npos);
  const BoardDescription smallest{BoardKind::kChess, 3, 3, 20.0, 0.0};
  EXPECT_EQ(smallest.Validate().code(), StatusCode::kUsage) << "its 4 corners can never be enough";
}

}  // namespace
}  // namespace stratalux::fit
