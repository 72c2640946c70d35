// SPDX-License-Identifier: Apache-2.0
// Light reflected by the surface itself of the skin (beyond [M]). Its share of the narrow light is not told by the SRDs
// of one pixel (model section 7), but it is colourless and follows the directions of lamp and eye in a way that light
// from the layers does not: the training lights of a whole session tell it.
//
// Torrance & Sparrow facets, each a mirror by Fresnel's law, unpolarised. How many of them tilt how far follows GGX
// [Walter et al. 2007] of one strength and roughness (skin: Weyrich et al. 2006) times a curve that the session's own
// light draws, since no analytic distribution is that of skin; beside them fine hairs (docs/math/surface.md).
#pragma once

#include <Eigen/Core>
#include <array>
#include <span>

#include "fitter/mixture/gloss_field.h"
#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

// Tilts of a facet against the skin, degrees, that SurfaceReflection::over_ggx stands at.
inline constexpr std::array<double, 10> kFacetTiltsDeg = {0, 5, 10, 15, 20, 26, 33, 42, 55, 75};
using FacetCurve = std::array<double, kFacetTiltsDeg.size()>;

struct SurfaceReflection {
  double strength = -1.0;  // of the Fresnel reflection of a bare surface of index eta; negative: unknown
  double roughness = 0.3;  // alpha of GGX
  // As many times more facets tilt so far than GGX says: linear between kFacetTiltsDeg, beyond them as at the last.
  FacetCurve over_ggx = Ones();
  // Of hairs above the skin, thin and lying anyhow: their reflectance times both cosines, a quarter of their
  // optical depth where they scatter alike into all directions (Koenderink & Pont 2003).
  double hairs = 0.0;
  // Where the skin is glossier: over_ggx there is over_ggx + gloss by_gloss, and never below 0.
  FacetCurve by_gloss{};
  GlossField gloss = {};

  [[nodiscard]] bool Known() const { return strength >= 0.0; }

 private:
  static constexpr FacetCurve Ones() {
    FacetCurve ones{};
    ones.fill(1.0);
    return ones;
  }
};

// Cosines at a point between its normal, the directions to lamp and eye, and the bisector of those two.
struct ReflectionAngles {
  double normal_in = 1.0, normal_out = 1.0, normal_half = 1.0, half_in = 1.0;

  // Unit vectors.
  [[nodiscard]] static ReflectionAngles Between(const Eigen::Vector3d& to_lamp, const Eigen::Vector3d& to_eye,
                                                const Eigen::Vector3d& normal);
  [[nodiscard]] static ReflectionAngles Of(const SrdBatch& batch, int64_t profile);
};

// pi f_r, the reflectance unit of model section 6; 0 behind the horizon and where the surface is unknown. `gloss`: of
// the place (SurfaceReflection::gloss).
[[nodiscard]] double ReflectanceOf(const SurfaceReflection& surface, const ReflectionAngles& angles, double eta,
                                   double gloss = 0.0);

// The same of a profile under its light.
[[nodiscard]] double ReflectedBy(const SurfaceReflection& surface, const SrdBatch& batch, int64_t profile, double eta);

// Response to all columns of a comb at once, as reflectance: of the white frames, else the cycle's (or window's) sum;
// and its variance.
struct WhiteReflectance {
  double value = 0.0, variance = 0.0;
};
[[nodiscard]] WhiteReflectance WhiteReflectanceOf(const SrdBatch& batch, int64_t profile);

// What EM holds of it: as ReflectedBy(), but no more than kMostSurface of what that light itself shows (of which a
// reflection found for the whole face knows nothing; the mean of the lights would not do, since a light near the mirror
// shows several times as much of the surface as the others); negative where it is unknown.
inline constexpr double kMostSurface = 0.95;
[[nodiscard]] double HeldReflection(const SurfaceReflection& surface, const SrdBatch& batch, int64_t profile,
                                    double eta);

// Robust least squares over the lights of one pixel in `every`, or of one in so many that 6,000 at most are left, W_pc
// a profile's own, the rest the session's:
//   y_pc = W_c g_p(tau) (1 - n_c + n_c few_p) + strength R_p(roughness).
// n_c few_p: the share of light that scattered a few times only, with the phase function of directional_weights.h; left
// out, it would pass for surface. First strength and roughness of GGX, by light within 60 degrees of the normal; then,
// by all light, the curve over it and the hairs, where they explain that light clearly better, and likewise the gloss,
// where `grid`, the lights' own, tells the spacing. Unknown where fewer than a hundred profiles are lit from two
// directions, and where those do not tell the strength. The same bits always.
[[nodiscard]] SurfaceReflection EstimateSurfaceReflection(std::span<const SrdBatch* const> lights,
                                                          const ProfileGrid& grid, double eta, int every = 8);

}  // namespace stratalux::fit
