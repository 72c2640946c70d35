// SPDX-License-Identifier: Apache-2.0
// The reconstructed surface as one light sees it: for every projector pixel the patch it lights and the flux that falls
// there. Any light goes through this: a projector of the rig, or a virtual one for point and directional lights.
#pragma once

#include <array>
#include <vector>

#include "fitter/reconstruction/surface_map.h"
#include "fitter/render/gather_kernel.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"
#include "shared/pattern/pattern.h"

namespace stratalux::fit {

// One sample of lit surface. Flux in the unit of WhiteTargetDn (digital numbers of a white target) times mm^2.
struct LitSample {
  Eigen::Vector3f point_mm = Eigen::Vector3f::Zero();  // camera frame
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();    // not normalised in blocks: their sum
  std::array<float, 3> flux{};
  float spread_mm2 = 0.0F;  // of blocks: mean squared distance of their light from point_mm
};

struct LitSurface {
  ProjectorCalibration light;
  double exposure_ms = 0.0;
  Image<LitSample> samples;  // projector pixels; zero flux where nothing is lit
};

// Rasterises the surface into the light's pixel grid with a depth buffer; triangles whose corners are not OnOneSurface
// bridge a discontinuity and are left out. What is rendered by it wants the surface WithRim: it ends at the centres of
// its last quads.
[[nodiscard]] LitSurface BuildLitSurface(const SurfaceMap& surface, const ProjectorCalibration& light,
                                         double exposure_ms);

// The surface lit by a pattern, as a pyramid of 2^k x 2^k blocks of the light's pixels: summed flux, flux-weighted mean
// position. A pattern counts times its scale.
struct LitPyramid {
  std::vector<LitPlanes> levels;
  int colour = 0;         // whose flux they hold: the light's brightest
  Image<float> pattern;   // in the light's pixels, as its optics blur it
  Image<float> shown;     // before the optics blurred it
  BlockWindow shown_lit;  // the least that holds all of its pixels that are not dark
};
[[nodiscard]] LitPyramid LightWith(const LitSurface& lit, const Pattern& pattern, double pattern_scale = 1.0);

// A virtual projector that lights the whole surface from `position_mm` (camera frame) with `dn` digital numbers of a
// white target facing it at the surface's centre. Far positions serve as directional lights. It looks at the centre;
// from so near that this would leave skin dark that faces it, at the middle of what it lights. kUsage: that is too much
// for one pinhole, since the surface goes round the light.
[[nodiscard]] Result<ProjectorCalibration> MakePointLight(const SurfaceMap& surface, const Eigen::Vector3d& position_mm,
                                                          const std::array<double, 3>& dn, int resolution = 512);

}  // namespace stratalux::fit
