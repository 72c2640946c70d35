// SPDX-License-Identifier: Apache-2.0
// Patterns as a projector's pattern memory takes them: bit planes (docs/capture-plan.md, "Files for pattern memories").
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "shared/base/result.h"
#include "shared/pattern/pattern.h"

namespace stratalux::rig {

// Bit planes a pattern needs: 1 for black and white pictures, 8 for grey ones.
[[nodiscard]] int PlanesOf(const Pattern& pattern);

// `patterns` one after the other, each as `planes` planes (1 or 8), the most significant first; a plane is its rows
// from the top, each padded to whole bytes, the leftmost pixel in the highest bit. Grey levels are linear light, 0 ..
// 255. Precondition: PlanesOf each pattern <= planes.
[[nodiscard]] std::vector<uint8_t> PackPatterns(const std::vector<Pattern>& patterns, int planes, int width,
                                                int height);
// The same behind the header that names it.
Status WritePatternMemory(const std::filesystem::path& file, const std::vector<Pattern>& patterns, int planes,
                          int width, int height);

}  // namespace stratalux::rig
