// SPDX-License-Identifier: Apache-2.0
// Flat targets in the plane z = 700 mm: white, grey ramp, colour chart, chessboard, ChArUco board, slab of wax. +x of a
// board runs along its columns, +y down its rows, its middle at the axis.
#pragma once

#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/scene/shape.h"

namespace stratalux::rig {

class Plate : public Shape {
 public:
  Plate(ShapeKind kind, const PlateDescription& description);

  [[nodiscard]] double Height(double x, double y) const override;
  [[nodiscard]] std::optional<Eigen::Vector3d> Intersect(const Ray3& ray) const override;
  [[nodiscard]] Eigen::Vector3d Normal(const Eigen::Vector3d&) const override { return {0.0, 0.0, -1.0}; }
  [[nodiscard]] bool Hides(const Eigen::Vector3d&, const Eigen::Vector3d&) const override { return false; }
  [[nodiscard]] Material MaterialAt(const Eigen::Vector3d& point, EyeLids) const override;

 private:
  [[nodiscard]] std::array<float, 3> Albedo(double x, double y) const;
  [[nodiscard]] bool IsWhiteOnBoard(double column, double row) const;

  ShapeKind kind_;
  PlateDescription description_;
  double width_mm_, height_mm_;
};

// Albedo (R, G, B) of the 24 patches of the classic colour chart, row by row, from dark skin to black.
[[nodiscard]] const std::array<std::array<float, 3>, 24>& ColourChart();

}  // namespace stratalux::rig
