// SPDX-License-Identifier: Apache-2.0
// Small analytic scenes for the renderer: one camera, one light, a surface z = f(x, y) in the camera frame.
#pragma once

#include <functional>
#include <vector>

#include "fitter/mixture/mixture_map.h"
#include "fitter/render/lit_surface.h"

namespace stratalux::fit {

inline constexpr double kDistanceMm = 500.0;  // from the camera to the middle of every scene
inline constexpr double kMosaicPixelMm = 0.8;
inline constexpr double kLightPixelMm = 0.4;  // facing the light
inline constexpr double kExposureMs = 4.0;

// Depth and its two slopes at (x, y).
struct Height {
  double z, dz_dx, dz_dy;
};
using HeightField = std::function<Height(double x, double y)>;

[[nodiscard]] HeightField FrontalPlane();
// A cheek-like dome with a nose that throws a shadow under oblique light.
[[nodiscard]] HeightField FaceLike();

struct LitScene {
  RigCalibration rig;
  SurfaceMap surface;
  LitSurface lit;
};
// Lamp at `lamp_mm` looking at the middle of the scene. Quads: 48 x 36 mono pixels, or 2x2 mosaic pixels of a colour
// camera.
[[nodiscard]] LitScene MakeScene(const HeightField& field, const Eigen::Vector3d& lamp_mm, Cfa cfa = Cfa::kMono,
                                 double light_blur_px = 0.6);

struct Layer {
  float weight, depth_mm, sigma_mm;
};
// The same layers everywhere.
[[nodiscard]] MixtureMap UniformSkin(const LitScene& scene, const std::vector<Layer>& layers);
// Every pixel its own layers: all parameters times 0.5 .. 1.5, smooth over the image.
[[nodiscard]] MixtureMap VaryingSkin(const LitScene& scene, const std::vector<Layer>& layers);

[[nodiscard]] std::vector<Layer> SkinLayers();
// One line of the light, `width` columns wide, in the middle of its image.
[[nodiscard]] Pattern MiddleLine(const LitScene& scene, int width);

}  // namespace stratalux::fit
