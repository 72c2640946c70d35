// SPDX-License-Identifier: Apache-2.0
#include "tests/rig-vm/loop_scene.h"

#include "firmware-host/projector/display_picture.h"
#include "shared/image/image.h"

namespace stratalux::rig {

std::vector<float> LoopLight(const Pattern& pattern, int projector, int projector_width, int projector_height) {
  Image<uint32_t> picture(projector_width, projector_height);
  DrawPattern(pattern, 1.0, projector_width, picture);
  const float white_dn = projector == 0 ? 1600.0F : 1400.0F;
  constexpr float kLeak = 0.02F;  // of white, in the black of a real module
  std::vector<float> light(static_cast<size_t>(kLoopWidth) * kLoopHeight);
  for (int y = 0; y < kLoopHeight; ++y)
    for (int x = 0; x < kLoopWidth; ++x) {
      const float u = 2.0F * static_cast<float>(x) / kLoopWidth - 1.0F;
      const float v = 2.0F * static_cast<float>(y) / kLoopHeight - 1.0F;
      const uint32_t pixel = picture(x * projector_width / kLoopWidth, y * projector_height / kLoopHeight);
      const float level = static_cast<float>(pixel & 0xffU) / 255.0F;
      light[static_cast<size_t>(y) * kLoopWidth + x] =
          white_dn * (1.0F - 0.2F * (u * u + v * v)) * (kLeak + (1.0F - kLeak) * level);
    }
  return light;
}

}  // namespace stratalux::rig
