// SPDX-License-Identifier: Apache-2.0
// OpenCV 4.7 and later: objdetect. The board is that of 4.6: with an even number of rows, too, the first square is
// black (before 4.6 it was white: setLegacyPattern).
#include <opencv2/objdetect/charuco_detector.hpp>

#include "fitter/calibration/charuco_corners.h"

namespace stratalux::fit {

std::vector<cv::Point2f> FindCharucoCorners(const cv::Mat& eight, const BoardDescription& board,
                                            std::vector<int>& ids) {
  const cv::aruco::CharucoBoard charuco({board.columns, board.rows}, static_cast<float>(board.square_mm),
                                        static_cast<float>(board.marker_mm),
                                        cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50));
  std::vector<cv::Point2f> corners;
  cv::aruco::CharucoDetector(charuco).detectBoard(eight, corners, ids);
  return corners;
}

}  // namespace stratalux::fit
