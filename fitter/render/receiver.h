// SPDX-License-Identifier: Apache-2.0
// What a camera pixel of one colour is on the surface, ready to receive light. Internal to fitter/render.
#pragma once

#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/mixture_map.h"
#include "fitter/render/lit_surface.h"

namespace stratalux::fit {

// Where the rays of a quad's pixels (mosaic px) meet its tangent plane.
class QuadPlane {
 public:
  QuadPlane(const SurfaceMap& surface, const RigCalibration& rig, int i, int j)
      : camera_(&rig.camera.model), normal_(surface.Normal(i, j)), distance_(normal_.dot(surface.Point(i, j))) {}
  [[nodiscard]] Eigen::Vector3d At(const Eigen::Vector2d& pixel) const {
    const Eigen::Vector3d ray = camera_->Unproject(pixel);
    return ray * (distance_ / normal_.dot(ray));
  }

 private:
  const Pinhole* camera_;
  Eigen::Vector3d normal_;
  double distance_;
};

struct Receiver {
  Eigen::Vector3d point, normal, shift;  // shift: T(omega_i) - T(omega_o), mm per mm of depth, tangential
  double gain = 1.0;
  RefractedDirections directions;
  double footprint2 = 0.0;  // variance of the camera pixel's part on the surface, mm^2
  double pitch_mm = 1.0;    // of the light's pixels on the surface, mean of both axes
  // Variance below which the light's pixels sample a Gaussian too coarsely (0.55 of the longer pitch: 0.5 % of ripple):
  // such layers read the pattern itself.
  double narrowest2 = 0.0;
  Eigen::Vector3d point_in_light, shift_in_light;  // frame of the light
  Eigen::Vector3d column_per_mm, row_per_mm;       // gradient of the light's pixel coordinates
};

// A Gaussian that stands for a camera pixel's box, or for a part of it: where it lies (mosaic px from the quad's
// centre), its variance along the mosaic's axes (px^2) and its share of the quad's colour.
struct PixelPart {
  Eigen::Vector2d site, variance_px2;
  double share = 1.0;
};
// Of a quad's `sites` of one colour. Along an axis that is long in the light's pixels a pixel is taken as two parts
// (pixel_box.h), as the fit takes it: a Receiver is round.
[[nodiscard]] std::vector<PixelPart> PixelParts(const SurfaceMap& surface, const RigCalibration& rig,
                                                const ProjectorCalibration& light, int i, int j,
                                                std::span<const Eigen::Vector2d> sites);

// nullopt where the surface turns away from light or camera.
[[nodiscard]] std::optional<Receiver> MakeReceiver(const ScatteringModel& model, const SurfaceMap& surface,
                                                   const RigCalibration& rig, const ProjectorCalibration& light, int i,
                                                   int j, const PixelPart& part);

// Something nearer to the light takes it: the light's pixel shows another place.
[[nodiscard]] bool InShadow(const LitSurface& lit, const Eigen::Vector2d& at, const Eigen::Vector3d& point);

// Shares of a Gaussian (mean, standard deviation in pixels of a light along one axis) that fall on its pixels first,
// first + 1, ...
struct PixelShares {
  int first = 0;
  std::vector<double> share;
  PixelShares(double mean, double sigma);
  // First and last pixel read of so many; beyond the edge, the edge.
  [[nodiscard]] std::pair<int, int> Read(int pixels) const;
};

// What a pattern, as LitPyramid::shown, sends to a Gaussian of these shares; `lit` holds all of it that is not dark.
[[nodiscard]] double ShownTo(const PixelShares& columns, const PixelShares& rows, const Image<float>& shown,
                             const BlockWindow& lit);

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
  [[nodiscard]] static double PixelSigma(const Receiver& receiver, const LitSurface& lit, const Eigen::Vector3d& per_mm,
                                         double variance);

  double white_dn_ = 0.0;  // 0 in shadow
  PixelShares columns_, rows_;
};

}  // namespace stratalux::fit
