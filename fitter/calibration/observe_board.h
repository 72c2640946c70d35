// SPDX-License-Identifier: Apache-2.0
// From the frames of one board pose to its corners in camera and projectors, or to what is wrong with them.
#pragma once

#include <string>
#include <vector>

#include "fitter/calibration/board_detector.h"
#include "fitter/calibration/observations.h"
#include "fitter/structured_light/decoded_map.h"
#include "shared/base/result.h"
#include "shared/image/image.h"
#include "shared/image/pixel_format.h"

namespace stratalux::fit {

// A picture of the board in one projector's light: `lit` less `dark`, raw mosaics, the mosaic's colours brought to one
// level (the board is grey). Digital numbers of green, or of a mono camera.
[[nodiscard]] Image<float> BoardLight(ImageView<const uint16_t> lit, ImageView<const float> dark, Cfa cfa);

struct ObserveOptions {
  double max_motion_px = 0.25;         // of the corners' median between two pictures of a pose
  double max_saturated = 0.02;         // share of the samples about the corners
  double min_corners = 0.5;            // share of the board's corners that the camera must see, and kLeastCorners
  double min_projector_corners = 0.7;  // share of those that a projector must light, else it sits the pose out
};

// What one projector shows of the pose.
struct ProjectorPictures {
  int projector = 0;
  Image<float> white_light;  // BoardLight of its white frame, taken before its codes
  // The same of the mean of its last code and that code's inverse, taken at their end; empty: not captured as a pair.
  Image<float> codes_light;
  Image<uint8_t> saturated;  // 1: the white frame's sample is
};

// Corners in the light of all projectors together, and the same in each picture apart: no motion, no saturation.
// Errors (kNotFound, kFailed) say what is wrong and what to do. Pixels of the frames.
[[nodiscard]] Result<std::vector<BoardCorner>> FindStillBoard(const std::vector<ProjectorPictures>& pictures,
                                                              const BoardDescription& board,
                                                              const ObserveOptions& options = {});

struct ProjectorCorners {
  std::vector<std::optional<Eigen::Vector2d>> column_row;  // of each corner
  bool seen = false;  // enough of them; else the projector does not light this pose
};
// `code_columns`, `code_rows`: of the projector. kFailed: the codes of columns or rows come inverted.
[[nodiscard]] Result<ProjectorCorners> LookUpCorners(const DecodedMap& map, const std::vector<BoardCorner>& corners,
                                                     const DeviceSize& projector, const ObserveOptions& options = {});

}  // namespace stratalux::fit
