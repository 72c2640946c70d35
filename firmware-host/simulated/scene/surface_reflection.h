// SPDX-License-Identifier: Apache-2.0
// Light that a surface reflects without letting it in: facets, and the fuzz of fine hairs above them.
//
//   pi f_r(i, o) = pi [ strength facets(i, o) E(i, o) + f_fuzz(i, o) ],   E = exp(-tau (1/n.i + 1/n.o))
//
// kGgx, the form that the fitter fits, too, but for F (Walter et al. 2007): D of GGX, Smith's G(i) G(o), Schlick's F
// from 0.028. kBeckmann shares nothing with it but Torrance & Sparrow's F D G / (4 n.i n.o):
//   D = exp(-tan^2 / m^2) / (pi m^2 cos^4)                       Gaussian slopes, mean square m^2 (Beckmann 1963)
//   G = 1 / (1 + Lambda(i) + Lambda(o)),   Lambda = (erf a - 1) / 2 + exp(-a^2) / (2 a sqrt(pi)),   a = cot / m
//                                                                masking and shadowing of one height (Heitz 2014)
//   F = Fresnel's, unpolarised, of `index`
// and two of them side by side: `wide_share` of the area has slopes `wide_roughness`, the rest `roughness`.
// Fuzz: isotropic scatterers that absorb nothing, above the surface, to optical depth tau, once scattered
// (Koenderink & Pont 2003):
//   f_fuzz = (1 - exp(-tau (1/n.i + 1/n.o))) / (4 pi (n.i + n.o)),   tau / (4 pi n.i n.o) where thin.
//
// Reciprocal. kBeckmann with strength <= 1 returns no more light than arrives: facets by Smith's masking, and the fuzz
// no more than half of what E takes from them on the way in.
#pragma once

#include <Eigen/Core>
#include <cstdint>

namespace stratalux::rig {

enum class FacetForm : uint8_t { kGgx, kBeckmann };

struct SurfaceReflection {
  FacetForm form = FacetForm::kGgx;
  float strength = 1.0F;    // kGgx: relative to skin's Fresnel reflection; kBeckmann: share of the area, at most 1
  float roughness = 0.35F;  // GGX's alpha, Beckmann's m (skin: Weyrich et al. 2006 find 0.25 to 0.4 over the face)
  float wide_roughness = 0.35F, wide_share = 0.0F;  // kBeckmann
  float index = 1.4F;                               // kBeckmann
  float fuzz_depth = 0.0F;                          // tau
};

// pi f_r: 1 for a white Lambertian body. Unit vectors from the point; 0 where `in` or `out` lies behind the surface.
[[nodiscard]] double ReflectanceOf(const SurfaceReflection& surface, const Eigen::Vector3d& normal,
                                   const Eigen::Vector3d& in, const Eigen::Vector3d& out);

}  // namespace stratalux::rig
