// SPDX-License-Identifier: Apache-2.0
// What a batch of SRDs holds of directions, for profiles made up by tests.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>

#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit::test {

// Of one more profile: unit vectors from the skin to lamp and eye, its normal, and a tangent across the lines.
inline void AddDirections(const Eigen::Vector3d& lamp, const Eigen::Vector3d& eye, const Eigen::Vector3d& normal,
                          const Eigen::Vector3d& along, SrdBatch& batch) {
  const Eigen::Vector3d across = normal.cross(along);
  const auto slope = [&](const Eigen::Vector3d& w, const Eigen::Vector3d& e) {
    return static_cast<float>(w.dot(e) / std::max(normal.dot(w), 1e-3));
  };
  batch.slope_in.push_back(slope(lamp, along));
  batch.slope_in_across.push_back(slope(lamp, across));
  batch.slope_out.push_back(slope(eye, along));
  batch.slope_out_across.push_back(slope(eye, across));
  batch.cos_in.push_back(static_cast<float>(normal.dot(lamp)));
  batch.cos_out.push_back(static_cast<float>(normal.dot(eye)));
}

}  // namespace stratalux::fit::test
