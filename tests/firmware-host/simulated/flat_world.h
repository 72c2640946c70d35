// SPDX-License-Identifier: Apache-2.0
// A subject whose light can be computed by hand: the scene "plane" with the same skin everywhere, seen and lit from
// chosen angles; and the response of a camera pixel to each projector column by brute-force quadrature of the skin
// table's kernel.
#pragma once

#include <vector>

#include "firmware-host/simulated/light_transport.h"

namespace stratalux::rig {

struct FlatWorldOptions {
  SkinParameters skin{0.03F, 0.004F};
  double view_deg = 0.0;       // from the normal, towards the tangent +t; the camera reaches -22 .. 3 degrees
  double light_deg = 45.0;     // likewise
  double light_row_deg = 0.0;  // turns the lamp about the normal, out of the plane of the camera
  double light_mm = 800.0;     // distance of the projector's centre
  int camera_width = 1392;     // mosaic pixels over 300 mm
  int projector_px = 256;      // width and height; 256 reach as far as the kernel
  Cfa cfa = Cfa::kMono;        // mono sees R
  double line_blur_px = 0.0;
};

class FlatWorld {
 public:
  explicit FlatWorld(const FlatWorldOptions& options);

  const RigCalibration& rig() const { return rig_; }
  const ProjectorCalibration& projector() const { return rig_.projectors[0]; }
  RigCalibration& rig() { return rig_; }
  const Scene& scene() const { return scene_; }
  const SkinTable& table() const { return table_; }
  const SkinAlbedo& albedo() const { return albedo_; }
  // Unit vectors: out of the plane; along it, in the sense of rising x and of rising columns.
  const Eigen::Vector3d& normal() const { return normal_; }
  const Eigen::Vector3d& tangent() const { return tangent_; }

  // The pixel at the aim, and those `dx`, `dy` mosaic pixels beside it.
  [[nodiscard]] SubjectPixel Pixel(int dx = 0, int dy = 0) const;
  [[nodiscard]] LightTransport Transport(const std::vector<SubjectPixel>& pixels,
                                         LightTransportOptions options = {}) const;

  // DN above black per ms of a white Lambertian target: intensity n.l / d^2.
  [[nodiscard]] double Irradiance(const Eigen::Vector3d& point, int colour) const;
  // The table's kernel for light and view at the pixel, and its frame on the plane (x: towards the lamp).
  struct LocalKernel {
    SkinKernel kernel;
    Eigen::Vector3d x, y;
  };
  [[nodiscard]] LocalKernel KernelAt(const SubjectPixel& pixel) const;
  // Response of the pixel to each projector column, DN per ms, mean over the pixel's footprint: polar quadrature.
  [[nodiscard]] std::vector<double> ColumnResponse(const SubjectPixel& pixel) const;

 private:
  FlatWorldOptions options_;
  Scene scene_;
  SkinTable table_;
  SkinAlbedo albedo_;
  RigCalibration rig_;
  Eigen::Vector3d normal_, tangent_;
  Eigen::Vector2i aim_px_;
};

// Response of every pixel to each projector column: subsurface light of combs with a single line of one column.
[[nodiscard]] std::vector<std::vector<double>> RenderedColumnResponses(const LightTransport& transport, size_t pixels,
                                                                       int columns);

}  // namespace stratalux::rig
