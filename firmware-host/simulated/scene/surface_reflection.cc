// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/surface_reflection.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace stratalux::rig {
namespace {

constexpr double kPi = std::numbers::pi;
// Skin's surface reflection: Fresnel at normal incidence for n = 1.4.
constexpr double kF0 = 0.028;

// Cosines between normal, directions and their bisector; ni, no > 0.
struct Cosines {
  double ni, no, nh, hi;
};

// 1 / sr.
double Ggx(const Cosines& c, double roughness) {
  const double a2 = roughness * roughness;
  const double d = a2 / (kPi * std::pow(c.nh * c.nh * (a2 - 1.0) + 1.0, 2));
  auto smith = [a2](double x) { return 2.0 * x / (x + std::sqrt(a2 + (1.0 - a2) * x * x)); };
  const double f = kF0 + (1.0 - kF0) * std::pow(1.0 - std::max(0.0, c.hi), 5);
  return d * f * smith(c.ni) * smith(c.no) / (4.0 * c.ni * c.no);
}

// Unpolarised, from air into `index`.
double Fresnel(double cos_in, double index) {
  const double g = std::sqrt(index * index - 1.0 + cos_in * cos_in);
  const double s = (g - cos_in) / (g + cos_in);
  const double p = (cos_in * (g + cos_in) - 1.0) / (cos_in * (g - cos_in) + 1.0);
  return 0.5 * s * s * (1.0 + p * p);
}

// Smith's Lambda for Gaussian slopes: area of facets turned away, over the area seen.
double Hidden(double cosine, double m) {
  const double sine = std::sqrt(std::max(0.0, 1.0 - cosine * cosine));
  if (!(sine > 0.0)) return 0.0;
  const double a = cosine / (m * sine);
  return 0.5 * (std::exp(-a * a) / (a * std::sqrt(kPi)) - std::erfc(a));
}

// D G / (4 ni no), 1 / sr.
double Beckmann(const Cosines& c, double m) {
  const double nh2 = c.nh * c.nh, m2 = m * m;
  const double d = std::exp((1.0 - 1.0 / nh2) / m2) / (kPi * m2 * nh2 * nh2);
  return d / ((1.0 + Hidden(c.ni, m) + Hidden(c.no, m)) * 4.0 * c.ni * c.no);
}

// Over the strength, 1 / sr.
double Facets(const SurfaceReflection& surface, const Cosines& c) {
  if (surface.form == FacetForm::kGgx) return Ggx(c, surface.roughness);
  double lobes = (1.0 - surface.wide_share) * Beckmann(c, surface.roughness);
  if (surface.wide_share > 0.0F) lobes += surface.wide_share * Beckmann(c, surface.wide_roughness);
  return Fresnel(std::max(0.0, c.hi), surface.index) * lobes;
}

}  // namespace

double ReflectanceOf(const SurfaceReflection& surface, const Eigen::Vector3d& normal, const Eigen::Vector3d& in,
                     const Eigen::Vector3d& out) {
  const double ni = normal.dot(in), no = normal.dot(out);
  if (ni <= 0.0 || no <= 0.0) return 0.0;
  const Eigen::Vector3d h = (in + out).normalized();
  const double facets = kPi * surface.strength * Facets(surface, {ni, no, normal.dot(h), h.dot(in)});
  if (!(surface.fuzz_depth > 0.0F)) return facets;
  const double through = -surface.fuzz_depth * (1.0 / ni + 1.0 / no);
  return facets * std::exp(through) - std::expm1(through) / (4.0 * (ni + no));
}

}  // namespace stratalux::rig
