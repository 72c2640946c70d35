// SPDX-License-Identifier: Apache-2.0
// The board's inner corners in one camera image, to a fraction of a pixel.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "fitter/calibration/board.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::fit {

struct BoardCorner {
  int corner = 0;            // BoardDescription::CornerMm
  Eigen::Vector2d pixel_px;  // in the image
};

// `light`: one channel, linear, any unit, free of mosaic (BoardLight). Chessboards are found whole or not at all (which
// of their corners comes first is arbitrary); of a ChArUco board, the corners beside a marker that was read.
// kNotFound says what was looked for. Reentrant.
[[nodiscard]] Result<std::vector<BoardCorner>> FindBoard(ImageView<const float> light, const BoardDescription& board);

}  // namespace stratalux::fit
