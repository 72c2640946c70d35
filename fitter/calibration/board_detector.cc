// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/board_detector.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "fitter/calibration/charuco_corners.h"

namespace stratalux::fit {
namespace {

constexpr double kWhitePercentile = 0.98;

// 8 bits with the square root of light, so that steps in the dark squares are no coarser than the noise.
cv::Mat ToEightBits(ImageView<const float> light) {
  std::vector<float> sorted(light.pixels().begin(), light.pixels().end());
  const auto at =
      sorted.begin() + static_cast<std::ptrdiff_t>(kWhitePercentile * static_cast<double>(sorted.size() - 1));
  std::nth_element(sorted.begin(), at, sorted.end());
  const float white = std::max(*at, 1e-6F);
  cv::Mat eight(light.height(), light.width(), CV_8U);
  for (int y = 0; y < light.height(); ++y)
    for (int x = 0; x < light.width(); ++x)
      eight.at<uint8_t>(y, x) =
          static_cast<uint8_t>(std::lround(235.0F * std::sqrt(std::clamp(light(x, y) / white, 0.0F, 1.17F))));
  return eight;
}

// Least distance between neighbouring corners, px.
double LeastSpacing(const std::vector<cv::Point2f>& corners) {
  double least = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < corners.size(); ++i)
    for (size_t j = i + 1; j < corners.size(); ++j) least = std::min(least, cv::norm(corners[i] - corners[j]));
  return least;
}

// Saddle points by the orthogonality of gradients [Foerstner 1987]. The window must hold nothing but the corner's four
// squares: on a ChArUco board, it ends where markers begin.
void Refine(ImageView<const float> light, const BoardDescription& board, std::vector<cv::Point2f>& corners) {
  const double spacing = LeastSpacing(corners);
  const double share =
      board.kind == BoardKind::kChess ? 0.3 : 0.9 * 0.5 * (board.square_mm - board.marker_mm) / board.square_mm;
  const int half = std::clamp(static_cast<int>(share * spacing), 2, 11);
  const cv::Mat image(light.height(), light.width(), CV_32F, const_cast<float*>(light.data()));
  cv::cornerSubPix(image, corners, cv::Size(half, half), cv::Size(-1, -1),
                   cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 60, 1e-3));
}

std::vector<cv::Point2f> FindChess(const cv::Mat& eight, const BoardDescription& board, std::vector<int>& ids) {
  std::vector<cv::Point2f> corners;
  const cv::Size inner(board.columns - 1, board.rows - 1);
  if (!cv::findChessboardCorners(eight, inner, corners, cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE))
    return {};
  ids.resize(corners.size());
  for (size_t i = 0; i < ids.size(); ++i) ids[i] = static_cast<int>(i);
  return corners;
}

}  // namespace

Result<std::vector<BoardCorner>> FindBoard(ImageView<const float> light, const BoardDescription& board) {
  SLX_RETURN_IF_ERROR(board.Validate());
  const std::string wanted = std::string(ToString(board.kind)) + " board of " + std::to_string(board.columns) + "x" +
                             std::to_string(board.rows) + " squares";
  std::vector<int> ids;
  std::vector<cv::Point2f> corners;
  try {
    const cv::Mat eight = ToEightBits(light);
    corners = board.kind == BoardKind::kChess ? FindChess(eight, board, ids) : FindCharucoCorners(eight, board, ids);
    if (corners.size() < 4)
      return Status::NotFound("no " + wanted + " in the picture; show all of it, check its kind and number of squares");
    Refine(light, board, corners);
  } catch (const cv::Exception& error) {
    return Status::Failed("looking for a " + wanted + ": " + error.err);
  }
  std::vector<BoardCorner> found;
  for (size_t i = 0; i < corners.size(); ++i) found.push_back({ids[i], {corners[i].x, corners[i].y}});
  return found;
}

}  // namespace stratalux::fit
