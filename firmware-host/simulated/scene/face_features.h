// SPDX-License-Identifier: Apache-2.0
// Where the features of a head lie and how far they reach: drawn once by its proportions and the seed, and shared by
// its surface and the skin on it. The face's own frame: nose root at the origin, +x to the picture's right, +y down
// the face; mm.
#pragma once

#include <cstdint>
#include <vector>

#include "firmware-host/simulated/scene/bump.h"
#include "firmware-host/simulated/scene/description.h"

namespace stratalux::rig {

// The opening of an eye: a lens about (+-kEyeX, height of the lids), where the eye is open or its slit is drawn.
inline constexpr double kEyeX = 31.0, kEyeHalfWidth = 13.5, kEyeHalfHeight = 4.8;

struct FaceFeatures {
  double radius_x_mm = 76, radius_y_mm = 102, radius_z_mm = 85;  // of the head
  // What they raise (or sink); those of a pair at +x, mirrored at -x.
  Bump bridge, tip, wing, socket, lid, brow, cheekbone, upper_lip, lower_lip, chin_fold, chin;

  [[nodiscard]] static FaceFeatures Of(const HeadDescription& description, uint64_t seed);
  // All of them, both of each pair.
  [[nodiscard]] std::vector<Bump> Bumps() const;
};

[[nodiscard]] inline Bump Mirrored(Bump bump) {
  bump.cx = -bump.cx;
  return bump;
}

}  // namespace stratalux::rig
