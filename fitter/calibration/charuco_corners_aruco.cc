// SPDX-License-Identifier: Apache-2.0
// OpenCV 4.6: contrib's aruco.
#include <opencv2/aruco/charuco.hpp>

#include "fitter/calibration/charuco_corners.h"

namespace stratalux::fit {

std::vector<cv::Point2f> FindCharucoCorners(const cv::Mat& eight, const BoardDescription& board,
                                            std::vector<int>& ids) {
  const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50);
  const auto charuco = cv::aruco::CharucoBoard::create(board.columns, board.rows, static_cast<float>(board.square_mm),
                                                       static_cast<float>(board.marker_mm), dictionary);
  std::vector<std::vector<cv::Point2f>> markers;
  std::vector<int> marker_ids;
  cv::aruco::detectMarkers(eight, dictionary, markers, marker_ids);
  std::vector<cv::Point2f> corners;
  ids.clear();
  if (marker_ids.empty()) return corners;
  cv::aruco::interpolateCornersCharuco(markers, marker_ids, eight, charuco, corners, ids);
  return corners;
}

}  // namespace stratalux::fit
