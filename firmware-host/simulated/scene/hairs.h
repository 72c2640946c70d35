// SPDX-License-Identifier: Apache-2.0
// Opaque hairs lying on the skin, drawn once into a map of what they cover.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "shared/capture/surface_class.h"
#include "shared/image/image.h"

namespace stratalux::rig {

struct HairField {
  double per_cm2 = 40.0;
  double length_mm = 1.0;  // of the longest; the shortest has 0.6 of it
  double width_mm = 0.1;
  double direction_rad = 0.0;  // from +x towards +y; each hair turns by up to +-0.5 from it
  SurfaceClass surface = SurfaceClass::kHair;
};

class HairMap {
 public:
  // One hair from each cell of a jittered lattice whose root lies where `region`(x, y) holds. Another `stream`, other
  // hairs.
  void Grow(const HairField& field, uint64_t seed, uint64_t stream, const std::function<bool(double, double)>& region);
  // What hair lies there, the one grown last on top; kNone: none.
  [[nodiscard]] SurfaceClass At(double x, double y) const;

 private:
  void Draw(double x, double y, double angle_rad, double length_mm, const HairField& field);

  // Of a hair's middle line.
  struct Sample {
    double x_mm, y_mm;
    int64_t column, row;  // in 2^-32 of a cell
  };
  Image<uint8_t> covered_;      // SurfaceClass; empty: no hair
  std::vector<Sample> middle_;  // of the hair being drawn
};

}  // namespace stratalux::rig
