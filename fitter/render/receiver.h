// SPDX-License-Identifier: Apache-2.0
// A pixel of one colour, ready to receive light. Internal to fitter/render.
#pragma once

#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/mixture_map.h"
#include "fitter/render/lit_surface.h"

namespace stratalux::fit {

struct Receiver {
  Eigen::Vector3d point, normal, shift;  // shift: T(omega_i) - T(omega_o), mm per mm of depth, tangential
  double gain = 1.0;
  RefractedDirections directions;
  double footprint2 = 0.0;  // variance of the camera pixel's box on the surface, mm^2
  double pitch_mm = 1.0;    // of the light's pixels on the surface, mean of both axes
  // Variance below which the light's pixels sample a Gaussian too coarsely (0.55 of the longer pitch: 0.5 % of ripple):
  // such layers read the pattern itself.
  double narrowest2 = 0.0;
  Eigen::Vector3d point_in_light, shift_in_light;  // frame of the light
  Eigen::Vector3d column_per_mm, row_per_mm;       // gradient of the light's pixel coordinates
};

// Of the site `site_in_quad` (mosaic px from the quad's centre); nullopt where the surface turns away from light or
// camera.
[[nodiscard]] std::optional<Receiver> MakeReceiver(const ScatteringModel& model, const SurfaceMap& surface,
                                                   const RigCalibration& rig, const ProjectorCalibration& light, int i,
                                                   int j, const Eigen::Vector2d& site_in_quad);

// Something nearer to the light takes it: the light's pixel shows another place.
[[nodiscard]] bool InShadow(const LitSurface& lit, const Eigen::Vector2d& at, const Eigen::Vector3d& point);

// A layer too narrow for the light's pixels to sample it: what it takes of each of them. Irradiance times the mean over
// the layer's Gaussian, blurred by the light's optics, of the pattern, whose pixels are boxes, on the tangent plane,
// where the surface is as good as flat. Columns and rows are taken as independent.
class NarrowLayer {
 public:
  // `at`: the light's pixel that shows `centre`. `variance`: of layer and camera pixel, mm^2.
  NarrowLayer(const Receiver& receiver, const LitSurface& lit, const Eigen::Vector3d& centre, const Eigen::Vector2d& at,
              double variance, int channel);
  // Light of the layer under a pattern, as LitPyramid::shown; `lit` holds all of it that is not dark.
  [[nodiscard]] double Under(const Image<float>& shown, const BlockWindow& lit) const;

 private:
  // Shares of a Gaussian (mean, standard deviation in pixels) that fall on pixels first, first + 1, ...
  struct PixelShares {
    int first = 0;
    std::vector<double> share;
    PixelShares(double mean, double sigma);
    // First and last pixel read of so many; beyond the edge, the edge.
    [[nodiscard]] std::pair<int, int> Read(int pixels) const;
  };
  [[nodiscard]] static double PixelSigma(const Receiver& receiver, const LitSurface& lit, const Eigen::Vector3d& per_mm,
                                         double variance);

  double white_dn_ = 0.0;  // 0 in shadow
  PixelShares columns_, rows_;
};

}  // namespace stratalux::fit
