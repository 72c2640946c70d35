// SPDX-License-Identifier: Apache-2.0
// A pattern's light where it falls: each of the projector's pixels is a box of even light, blurred by the optics'
// Gaussian. Positions and widths in projector pixels, pixel k about position k; beyond the picture's edge, the edge.
#pragma once

#include <span>
#include <vector>

#include "shared/image/image.h"

namespace stratalux::rig {

// What a projector of that gamma gives of grey levels, in place.
void ApplyGamma(std::span<float> levels, double gamma);

// Convolves with the discrete Gaussian of variance sigma^2: what each pixel holds when neighbours have shared out their
// light.
[[nodiscard]] std::vector<float> SharedOut(const std::vector<float>& profile, double sigma);
[[nodiscard]] Image<float> SharedOut(const Image<float>& image, double sigma);

// How much each pixel adds to the light at a point.
class BlurredBoxes {
 public:
  explicit BlurredBoxes(double sigma);
  // The first pixel that counts, and the shares of it and those that follow it.
  struct Shares {
    int first = 0;
    std::span<const float> of;
  };
  [[nodiscard]] Shares At(float position) const;
  // Pixels on either side of the nearest one that count.
  [[nodiscard]] int reach() const { return reach_; }

  static constexpr int kPhases = 64;  // to a pixel

 private:
  int reach_;
  std::vector<float> shares_;  // [phase][pixel]
};

// Light along one axis, averaged over what a camera pixel sees of it.
class LightAlongAxis {
 public:
  LightAlongAxis(std::span<const float> shown, double sigma);
  // Mean over a box of half-width a convolved with one of half-width b.
  [[nodiscard]] float Mean(float position, float a, float b) const;

 private:
  static constexpr int kNodes = 16;  // to a pixel; between them light is a straight line
  struct Place;
  [[nodiscard]] Place PlaceOf(double position) const;
  [[nodiscard]] double First(double position) const;
  [[nodiscard]] double Second(double position) const;

  int margin_;  // pixels before and behind the picture, beyond which light is even
  std::vector<float> light_;
  std::vector<double> first_, second_;  // antiderivatives
};

// The light of an image at (column, row), averaged over a parallelogram: what a camera pixel shows of the surface. `u`
// and `v`: its sides, from the camera pixel's.
struct PixelSides {
  float u_column = 0.0F, u_row = 0.0F, v_column = 0.0F, v_row = 0.0F;
};
[[nodiscard]] float MeanLight(const Image<float>& shown, const BlurredBoxes& boxes, float column, float row,
                              const PixelSides& sides);

}  // namespace stratalux::rig
