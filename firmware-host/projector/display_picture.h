// SPDX-License-Identifier: Apache-2.0
// What a display is sent: the mode that fits the wiring, and the pixels of a pattern.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "shared/image/image.h"
#include "shared/pattern/pattern.h"

namespace stratalux::rig {

struct DisplayMode {
  int width = 0;  // px
  int height = 0;
  double refresh_hz = 0.0;
};

// Index of the mode of that size: the one nearest to `refresh_hz`, at most 0.5 Hz off; 0 Hz: the fastest. nullopt where
// none fits.
[[nodiscard]] std::optional<size_t> PickMode(std::span<const DisplayMode> modes, int width, int height,
                                             double refresh_hz);

// Draws the pattern as grey XRGB8888 over the left `width` pixels of each row. `gamma`: the display's light is
// (level / 255)^gamma, hence level = 255 intensity^(1 / gamma).
void DrawPattern(const Pattern& pattern, double gamma, int width, ImageView<uint32_t> pixels);

}  // namespace stratalux::rig
