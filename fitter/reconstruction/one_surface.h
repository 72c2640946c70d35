// SPDX-License-Identifier: Apache-2.0
// Which samples belong to one surface: the one rule of islands, smoothing, meshes and rendering. It is scale-free: of
// a face at 0.7 m and of a board at 3.4 m, of small and of large pictures it asks the same.
#pragma once

#include <Eigen/Core>

#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// A surface whose normal leaves the view by theta goes tan(theta) times as far in depth as across the view. Beyond
// cos(theta) = 0.15 no light is measured (SrdOptions::min_cos): what is steeper is the step to another surface.
inline constexpr double kMaxSlope = 6.59;  // sqrt(1 / 0.15^2 - 1)
inline constexpr double kStepSigmas = 4.0;
// On a surface the chord between neighbours leaves the plane that is tangent at one by half of what the normal turns:
// 30 degrees where it turns by 60.
inline constexpr double kMaxChordSine = 0.5;

// Points in the camera's frame; `sigma_mm` of the difference of their depths, NaN where it is not known. Their ranges
// differ by no more than kMaxSlope times their distance across the view, and kStepSigmas times sigma.
[[nodiscard]] bool OnOneSurface(const Eigen::Vector3d& a_mm, const Eigen::Vector3d& b_mm, double sigma_mm);

// Of quads that are known. Where normals are known, points belong together as well if the chord between them lies in
// both tangent planes but for kMaxChordSine: at a silhouette, where a surface turns away from the view.
[[nodiscard]] bool OnOneSurface(const SurfaceMap& surface, int i, int j, int k, int l);

}  // namespace stratalux::fit
