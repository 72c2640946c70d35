// SPDX-License-Identifier: Apache-2.0
// Angles are radians in code; degrees appear only in configuration and reports.
#pragma once

#include <numbers>

namespace stratalux {

[[nodiscard]] constexpr double RadFromDeg(double deg) { return deg * std::numbers::pi / 180.0; }
[[nodiscard]] constexpr double DegFromRad(double rad) { return rad * 180.0 / std::numbers::pi; }

}  // namespace stratalux
