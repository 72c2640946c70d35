// SPDX-License-Identifier: Apache-2.0
// The skin kernel's spike, integrated over one camera pixel's footprint and over each projector pixel near it. The
// kernel is split smoothly at about a millimetre: the spike is summed in polar coordinates around each exit point,
// which keeps its total exact wherever the projector's pixels happen to lie; the rest is smooth enough for a few
// samples.
#pragma once

#include <Eigen/Core>
#include <array>
#include <numbers>

#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {

// Displacements on the tangent plane, mm.
struct TangentSteps {
  Eigen::Vector2f column, row;  // from one projector pixel to the next
  Eigen::Vector2f u, v;         // from one camera pixel to the next
  [[nodiscard]] float ProjectorPixelArea() const { return std::abs(column.x() * row.y() - column.y() * row.x()); }
};

// Two axes whose outer products add up to the covariance, mm^2, of a uniform point of a block of projector pixels plus
// one of the camera pixel's footprint.
struct Extent {
  Eigen::Vector2f a, b;
};
[[nodiscard]] Extent ExtentOf(const TangentSteps& steps, int block);

// Mean of f around `centre`, exact to second order over the extent.
template <typename F>
[[nodiscard]] float MeanOver(const Extent& extent, const Eigen::Vector2f& centre, const F& f) {
  const Eigen::Vector2f a = std::numbers::sqrt2_v<float> * extent.a, b = std::numbers::sqrt2_v<float> * extent.b;
  return 0.25F * (f(centre + a) + f(centre - a) + f(centre + b) + f(centre - b));
}

// Share of the spike in the kernel at distance r: 1 inside, 0 beyond kSpikeOuterMm.
inline constexpr float kSpikeInnerMm = 0.45F, kSpikeOuterMm = 1.0F;
[[nodiscard]] float SpikeShare(float r_mm);

// Projector pixels of one camera pixel's near field.
inline constexpr int kNearWindow = 20;
using NearField = std::array<float, kNearWindow * kNearWindow>;  // [row][column]

// Where the surface carries the window's projector pixels: on the tangent plane the light of one lies at
// TangentSteps x offset + bend, because a curved surface meets the ray earlier or later than the plane does.
struct NearSurface {
  std::array<Eigen::Vector2f, kNearWindow * kNearWindow> bend;  // mm, [row][column]
  std::array<float, kNearWindow * kNearWindow> area;            // lit by each projector pixel, mm^2; 0: elsewhere
};

// near[r][c] = mean of the kernel's spike over the light of projector pixel (first_column + c, first_row + r) and over
// the camera pixel's footprint; 1 / (mm^2 sr). `column_row`: the camera pixel's centre in projector pixels.
void IntegrateSpike(const SkinKernel& kernel, const TangentSteps& steps, const NearSurface& surface,
                    const Eigen::Vector2f& column_row, int first_column, int first_row, NearField& near);

// Mean over projector pixel and footprint of the kernel without its spike; `entry_mm`: where the projector pixel's
// light falls, from the camera pixel's point. 1 / (mm^2 sr).
[[nodiscard]] float MeanBesideSpike(const SkinKernel& kernel, const TangentSteps& steps,
                                    const Eigen::Vector2f& entry_mm);

}  // namespace stratalux::rig
