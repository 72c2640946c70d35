// SPDX-License-Identifier: Apache-2.0
// Light reflected by the very surface of the skin (beyond [M]). Its share of the narrow light is not told by the SRDs
// of one pixel (model section 7), but it is colourless and follows the directions of lamp and eye in a way that light
// from the layers does not: the training lights of a whole session tell it.
//
// Torrance & Sparrow facets, slopes distributed after GGX [Walter et al. 2007], Schlick's Fresnel term; one roughness
// and one strength for the session (skin: Weyrich et al. 2006).
#pragma once

#include <Eigen/Core>
#include <span>

#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

struct SurfaceReflection {
  double strength = -1.0;  // of the Fresnel reflection of a bare surface of index eta; negative: unknown
  double roughness = 0.3;  // alpha of GGX

  [[nodiscard]] bool Known() const { return strength >= 0.0; }
};

// Cosines at a point between its normal, the directions to lamp and eye, and the bisector of those two.
struct ReflectionAngles {
  double normal_in = 1.0, normal_out = 1.0, normal_half = 1.0, half_in = 1.0;

  // Unit vectors.
  [[nodiscard]] static ReflectionAngles Between(const Eigen::Vector3d& to_lamp, const Eigen::Vector3d& to_eye,
                                                const Eigen::Vector3d& normal);
  [[nodiscard]] static ReflectionAngles Of(const SrdBatch& batch, int64_t profile);
};

// pi f_r, the reflectance unit of model section 6; 0 behind the horizon and where the surface is unknown.
[[nodiscard]] double ReflectanceOf(const SurfaceReflection& surface, const ReflectionAngles& angles, double eta);

// Response to all columns of a comb at once, as reflectance: of the white frames, else the cycle's (or window's) sum;
// and its variance.
struct WhiteReflectance {
  double value = 0.0, variance = 0.0;
};
[[nodiscard]] WhiteReflectance WhiteReflectanceOf(const SrdBatch& batch, int64_t profile);

// Robust least squares over the lights of one pixel in `every`, or of one in so many that 6,000 at most are left, W_pc
// a profile's own, the rest the session's:
//   y_pc = W_c g_p(tau) (1 - n_c + n_c few_p) + strength R_p(roughness).
// n_c few_p: the share of light that scattered a few times only, with the phase function of directional_weights.h; left
// out, it would pass for surface. Unknown where fewer than a hundred profiles are lit from two directions, and where
// those do not tell the strength. The same bits always.
[[nodiscard]] SurfaceReflection EstimateSurfaceReflection(std::span<const SrdBatch* const> lights, int channels,
                                                          double eta, int every = 8);

}  // namespace stratalux::fit
