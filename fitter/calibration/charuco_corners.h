// SPDX-License-Identifier: Apache-2.0
// ChArUco corners by OpenCV, whose interface for them differs between the releases of Debian: one of the two
// implementations is built, cmake/StrataluxDependencies.cmake chooses.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "fitter/calibration/board.h"

namespace stratalux::fit {

// The inner corners seen in `eight` (8 bits, one channel), px, to about a pixel; `ids` numbers them as BoardDescription
// does. Both are empty where there is no marker. Throws cv::Exception.
[[nodiscard]] std::vector<cv::Point2f> FindCharucoCorners(const cv::Mat& eight, const BoardDescription& board,
                                                          std::vector<int>& ids);

}  // namespace stratalux::fit
