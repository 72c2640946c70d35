// SPDX-License-Identifier: Apache-2.0
// Multi-layered subsurface scattering [M 7, 8, 9]: what the fitted layers look like under any light.
//
//   L_o(x) = sum_l w_l(x) g(x) sum_I K2(x_I - x_O - d_l (T(omega_i) - T(omega_o)); sigma_l(x)) flux_I
//
// K2: two-dimensional Gaussian of the offset's length in space: light that scattered goes straight through a nose's
// ridge, which its projection on the tangent plane would make too near. Samples whose normals oppose that of x_O do not
// exchange light. Reference and fast renderer share this definition.
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/mixture_map.h"
#include "fitter/render/lit_surface.h"

namespace stratalux::fit {

struct RenderOptions {
  int pool = 1;  // quads per side that one profile of the MixtureMap covers
};

// Subsurface light under each of `lights`, patterns of the light that `lit` is lit by: W x H x C on quads, digital
// numbers above black; 0 outside the mask. Cost: pixels x layers; what does not depend on the pattern is worked out
// once for all of them. Each colour is rendered at its own site of the quad.
[[nodiscard]] std::vector<Image<float>> RenderSubsurface(const MixtureMap& map, const SurfaceMap& surface,
                                                         const RigCalibration& rig, const LitSurface& lit,
                                                         std::span<const LitPyramid> lights,
                                                         const RenderOptions& options = {});

// One of them by the plain double loop over all lit samples, in double precision. Cost: pixels x samples x layers.
[[nodiscard]] Image<float> RenderSubsurfaceReference(const MixtureMap& map, const SurfaceMap& surface,
                                                     const RigCalibration& rig, const LitPyramid& light,
                                                     const LitSurface& lit, const RenderOptions& options = {});

}  // namespace stratalux::fit
