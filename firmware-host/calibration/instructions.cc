// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/calibration/instructions.h"

#include <algorithm>
#include <array>

namespace stratalux::rig {
namespace {

constexpr std::array<const char*, kAdvisedPoses> kPoses = {
    "in the middle, leaning a little: top away from the camera by 10 degrees",
    "in the middle, 2 cm farther; top away by 20 degrees",
    "in the middle, 1 cm farther; top towards the camera by 20 degrees",
    "in the middle; left side away by 25 degrees",
    "in the middle, 2 cm farther; right side away by 25 degrees",
    "to the right, 3 cm farther; top and left side away by 20 degrees",
    "to the left, 2 cm nearer, turned by a quarter; top and left side towards the camera by 20 degrees",
    "to the upper right, 4 cm farther; top and right side away by 20 degrees",
    "to the lower left, 3 cm nearer; top towards the camera, left side away, by 20 degrees each",
    "to the top, 5 cm farther, turned by 60 degrees; top away by 30 degrees",
    "to the bottom, 4 cm nearer, turned by 20 degrees; top towards the camera by 30 degrees",
    "towards a corner that is not covered yet; left side away by 30 degrees"};

constexpr std::array<const char*, 3> kFlats = {
    "where a face would be, about facing the camera",
    "9 cm nearer than a face would be, tilted by some 20 degrees",
    "9 cm farther than a face would be, tilted by some 20 degrees the other way",
};

}  // namespace

std::string PoseInstruction(int pose) {
  const std::string text = kPoses[static_cast<size_t>(pose % kAdvisedPoses)];
  return pose < kAdvisedPoses ? text : text + ", towards a part of the picture that is not covered yet";
}

std::string LightInstruction(SessionKind kind, int pose) {
  switch (kind) {
    case SessionKind::kDark:
      return "dark: put the cap on the lens, close the door; no light may reach the camera";
    case SessionKind::kFlat:
      return std::string("flat: a flat, matt, white target (of known reflectance) that fills the picture, ") +
             kFlats[static_cast<size_t>(std::max(0, pose)) % kFlats.size()];
    case SessionKind::kResponse:
      return "response: the white target of the flat capture, not moved; let the projectors warm up for half an hour";
    default:
      return "";
  }
}

}  // namespace stratalux::rig
