// SPDX-License-Identifier: Apache-2.0
// The surface of the simulated skin, held to what any surface must do, to facets traced one by one, and to being no
// GGX.
#include "firmware-host/simulated/scene/surface_reflection.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/face_surface.h"
#include "shared/base/random.h"
#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

using Eigen::Vector3d;
constexpr double kPi = std::numbers::pi;
const Vector3d kNormal = Vector3d::UnitZ();

Vector3d Direction(double deg, double azimuth_deg = 0.0) {
  const double theta = RadFromDeg(deg), phi = RadFromDeg(azimuth_deg);
  return {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)};
}

SurfaceReflection Beckmann(double m, double index = 1.4) {
  return {.form = FacetForm::kBeckmann, .roughness = static_cast<float>(m), .index = static_cast<float>(index)};
}

// A face's surface at the dry cheek and on the oily forehead.
SurfaceReflection OfFace(SkinSurface form, double oiliness, double fuzz = 0.0) {
  return FaceSurface({.form = form, .oiliness = oiliness, .fuzz = fuzz}).At(0.0, -64.0);
}

std::vector<SurfaceReflection> Surfaces() {
  std::vector<SurfaceReflection> surfaces = {Beckmann(0.15), Beckmann(0.6), Beckmann(0.3, 1.55)};
  for (const SkinSurface form : {SkinSurface::kGgx, SkinSurface::kBeckmann, SkinSurface::kTwoLobes})
    for (const double oiliness : {0.0, 1.0})
      for (const double fuzz : {0.0, 1.0, 3.0}) surfaces.push_back(OfFace(form, oiliness, fuzz));
  return surfaces;
}

// Share of the light from `in` that returns, whatever the direction: the integral of f_r cos.
double Returned(const SurfaceReflection& surface, const Vector3d& in) {
  constexpr int kRings = 270, kSectors = 180;  // of half a turn: `in` lies in the plane of x
  double sum = 0.0;
  for (int i = 0; i < kRings; ++i) {
    const double deg = 90.0 * (i + 0.5) / kRings;
    double ring = 0.0;
    for (int k = 0; k < kSectors; ++k)
      ring += ReflectanceOf(surface, kNormal, in, Direction(deg, 180.0 * (k + 0.5) / kSectors));
    sum += ring * std::sin(2.0 * RadFromDeg(deg));
  }
  return sum * (kPi / 2 / kRings) / kSectors;
}

TEST(SurfaceReflection, IsReciprocalAndNeverNegative) {
  Random random(5);
  for (const SurfaceReflection& surface : Surfaces())
    for (int k = 0; k < 200; ++k) {
      const Vector3d a = Direction(random.Uniform(0, 89.9), random.Uniform(0, 360)),
                     b = Direction(random.Uniform(0, 89.9), random.Uniform(0, 360));
      const double there = ReflectanceOf(surface, kNormal, a, b);
      ASSERT_TRUE(std::isfinite(there)) << a.transpose() << "; " << b.transpose();
      EXPECT_GE(there, 0.0);
      EXPECT_NEAR(ReflectanceOf(surface, kNormal, b, a), there, 1e-12 * (1.0 + there));
    }
}

TEST(SurfaceReflection, IsNothingBehindTheHorizon) {
  for (const SurfaceReflection& surface : Surfaces()) {
    EXPECT_EQ(ReflectanceOf(surface, kNormal, Direction(91), Direction(20)), 0.0);
    EXPECT_EQ(ReflectanceOf(surface, kNormal, Direction(20), Direction(90.01)), 0.0);
  }
}

TEST(SurfaceReflection, ReturnsNoMoreLightThanArrives) {
  for (const SurfaceReflection& surface : Surfaces())
    for (const double deg : {0.0, 40.0, 70.0, 82.0, 87.0, 89.5}) {
      const double returned = Returned(surface, Direction(deg));
      EXPECT_GT(returned, 0.02) << deg;
      EXPECT_LT(returned, 1.0) << deg << " degrees, m " << surface.roughness << ", fuzz " << surface.fuzz_depth;
    }
}

// Fresnel's reflection, unpolarised, by the two angles.
double FresnelOf(double cos_in, double index) {
  const double cos_t = std::sqrt(1.0 - (1.0 - cos_in * cos_in) / (index * index));
  const double s = (cos_in - index * cos_t) / (cos_in + index * cos_t),
               p = (index * cos_in - cos_t) / (index * cos_in + cos_t);
  return 0.5 * (s * s + p * p);
}

// Share returned by a surface of Gaussian slopes, facet by facet: slopes are drawn as two normal numbers, a facet
// counts as the lamp sees it, and what it mirrors gets out with the chance that nothing stands before it. By Smith's
// assumption heights know nothing of slopes: of the facets that a lamp sees, the share of those below height h (a
// quantile) is h^(1 + hidden), and of what leaves at h the share h^hidden gets away. `hidden` itself is drawn, too.
struct Traced {
  double returned = 0.0, error = 0.0;
};
Traced TraceFacets(double m, double index, double deg, uint64_t seed) {
  constexpr int kFacets = 40000;
  const double step = m / std::numbers::sqrt2;
  // (area of facets turned towards a direction, as it sees them) / cosine - 1, by quadrature over the slope along it.
  auto hidden = [step](double cosine) {
    const double sine = std::sqrt(1.0 - cosine * cosine);
    double sum = 0.0;
    constexpr int kSteps = 120;
    for (int k = 0; k < kSteps; ++k) {
      const double slope = 6.0 * step * (2.0 * (k + 0.5) / kSteps - 1.0);
      sum += std::exp(-0.5 * slope * slope / (step * step)) / (step * std::sqrt(2.0 * kPi)) * (12.0 * step / kSteps) *
             std::max(0.0, cosine - slope * sine);
    }
    return sum / cosine - 1.0;
  };
  const Vector3d in = Direction(deg);
  const double hidden_in = hidden(in.z());
  Random random(seed);
  double sum = 0.0, squares = 0.0;
  for (int k = 0; k < kFacets; ++k) {
    const Vector3d across(-step * random.Normal(), -step * random.Normal(), 1.0);  // as long as the facet's area
    const double height = std::pow(1.0 - random.Uniform(), 1.0 / (1.0 + hidden_in)), chance = random.Uniform();
    const double seen = std::max(0.0, in.dot(across)) / (in.z() * (1.0 + hidden_in));
    if (seen == 0.0) continue;
    const Vector3d facet = across.normalized();
    const Vector3d out = 2.0 * in.dot(facet) * facet - in;
    if (out.z() <= 1e-6 || chance >= std::pow(height, hidden(out.z()))) continue;
    const double light = seen * FresnelOf(in.dot(facet), index);
    sum += light;
    squares += light * light;
  }
  const double mean = sum / kFacets;
  return {mean, std::sqrt((squares / kFacets - mean * mean) / kFacets)};
}

TEST(SurfaceReflection, ReturnsWhatItsFacetsMirrorOneByOne) {
  for (const double m : {0.18, 0.39})
    for (const double index : {1.4, 1.5})
      for (const double deg : {0.0, 35.0, 60.0, 80.0}) {
        const Traced traced = TraceFacets(m, index, deg, 11);
        const double returned = Returned(Beckmann(m, index), Direction(deg));
        EXPECT_LT(traced.error, 0.02 * traced.returned);
        // The quadrature's own error is a few tenths of a thousandth.
        EXPECT_NEAR(returned, traced.returned, 3.5 * traced.error + 5e-4 * returned)
            << "m " << m << ", index " << index << ", " << deg << " degrees";
      }
}

TEST(SurfaceReflection, TwoLobesAreTwoSurfacesSideBySide) {
  const SurfaceReflection two = OfFace(SkinSurface::kTwoLobes, 0.5);
  for (const double deg : {10.0, 50.0, 75.0}) {
    const double shares = (1.0 - two.wide_share) * TraceFacets(two.roughness, two.index, deg, 3).returned +
                          two.wide_share * TraceFacets(two.wide_roughness, two.index, deg, 4).returned;
    EXPECT_NEAR(Returned(two, Direction(deg)) / shares, 1.0, 0.03) << deg;
  }
}

TEST(SurfaceReflection, SmoothFacetsReturnFresnelsShare) {
  // Over facets h instead of directions: d omega_o = 4 (h.i) d omega_h; slopes are small, 5 m reach all of them.
  constexpr double kM = 0.01;
  for (const double strength : {1.0, 0.6})
    for (const double deg : {0.0, 30.0, 55.0, 70.0}) {
      SurfaceReflection surface = Beckmann(kM);
      surface.strength = static_cast<float>(strength);
      const Vector3d in = Direction(deg);
      double sum = 0.0;
      constexpr int kSteps = 200;
      for (int i = 0; i < kSteps; ++i)
        for (int j = 0; j < kSteps; ++j) {
          const double x = 5.0 * kM * (2.0 * (i + 0.5) / kSteps - 1.0), y = 5.0 * kM * (2.0 * (j + 0.5) / kSteps - 1.0);
          const Vector3d h = Vector3d(x, y, 1.0).normalized();
          const Vector3d out = 2.0 * h.dot(in) * h - in;
          const double solid_angle = std::pow(h.z(), 3) * std::pow(10.0 * kM / kSteps, 2) * 4.0 * h.dot(in);
          sum += ReflectanceOf(surface, kNormal, in, out) / kPi * out.z() * solid_angle;
        }
      EXPECT_NEAR(sum / (strength * FresnelOf(in.z(), 1.4)), 1.0, 0.005) << deg << " degrees";
    }
}

SurfaceReflection FuzzAlone(double depth) {
  return {.form = FacetForm::kBeckmann, .strength = 0.0F, .fuzz_depth = static_cast<float>(depth)};
}

TEST(SurfaceReflection, FuzzGrowsTowardsGrazingLightAndView) {
  for (const double depth : {0.005, 0.02, 0.06}) {
    const SurfaceReflection fuzz = FuzzAlone(depth);
    for (const double in : {0.0, 40.0, 80.0}) {
      double last = 0.0;
      for (double out = 0.0; out < 89.0; out += 4.0) {
        const double now = ReflectanceOf(fuzz, kNormal, Direction(in), Direction(out, 70));
        EXPECT_GT(now, last) << in << ", " << out << " degrees";
        last = now;
      }
    }
    // Thin: inversely proportional to both cosines [Koenderink & Pont 2003]; at most so much where it grazes.
    const Vector3d a = Direction(30), b = Direction(50, 120);
    EXPECT_NEAR(ReflectanceOf(FuzzAlone(1e-5), kNormal, a, b) * 4.0 * a.z() * b.z() / 1e-5, 1.0, 1e-4);
    const double grazing = std::cos(RadFromDeg(89.9));
    EXPECT_LT(ReflectanceOf(fuzz, kNormal, Direction(89.9), Direction(89.9)), 0.25 / (2.0 * grazing) * (1.0 + 1e-9));
  }
}

TEST(SurfaceReflection, WithoutFuzzThereIsNone) {
  EXPECT_EQ(ReflectanceOf(FuzzAlone(0.0), kNormal, Direction(85), Direction(85, 180)), 0.0);
  // What fuzz adds at grazing it takes from the facets at the mirror.
  const SurfaceReflection bare = OfFace(SkinSurface::kTwoLobes, 0.0), furry = OfFace(SkinSurface::kTwoLobes, 0.0, 1.0);
  EXPECT_GT(ReflectanceOf(furry, kNormal, Direction(75), Direction(75, 0)),
            2.0 * ReflectanceOf(bare, kNormal, Direction(75), Direction(75, 0)));
  EXPECT_LT(ReflectanceOf(furry, kNormal, Direction(80), Direction(80, 180)),
            ReflectanceOf(bare, kNormal, Direction(80), Direction(80, 180)));
}

TEST(SurfaceReflection, FuzzReturnsWhatALayerOfScatterersDoes) {
  // Light enters, is scattered once at an optical depth of -log(u), anywhere, and gets out or not.
  constexpr int kPhotons = 200000;
  for (const double depth : {0.02, 0.06})
    for (const double deg : {0.0, 60.0, 85.0}) {
      Random random(21);
      double sum = 0.0, squares = 0.0;
      const double cosine = std::cos(RadFromDeg(deg));
      for (int k = 0; k < kPhotons; ++k) {
        // Every photon meets a hair before the skin, with the weight of those that do.
        const double met = -std::expm1(-depth / cosine);
        const double at = -std::log1p(-random.Uniform() * met) * cosine, up = random.Uniform(-1.0, 1.0);
        const double light = up > 0.0 ? met * std::exp(-at / up) : 0.0;
        sum += light;
        squares += light * light;
      }
      const double mean = sum / kPhotons, error = std::sqrt((squares / kPhotons - mean * mean) / kPhotons);
      EXPECT_NEAR(Returned(FuzzAlone(depth), Direction(deg)), mean, 3.5 * error + 0.002 * mean) << depth << ", " << deg;
      EXPECT_LT(mean, 0.5 * -std::expm1(-depth / cosine));
    }
}

// The best that one GGX of any strength and roughness can do where light and view lie in a plane, each within 60
// degrees of the normal and 5 degrees apart: its residual over the surfaces' reflectance, root mean squares.
double ResidualOfOneGgx(const std::vector<SurfaceReflection>& surfaces) {
  double best = 1.0;
  for (double roughness = 0.1; roughness < 0.8; roughness += 0.004) {
    double square = 0.0, own = 0.0, both = 0.0;
    for (const SurfaceReflection& surface : surfaces)
      for (double in = -60.0; in <= 60.0; in += 5.0)
        for (double out = -60.0; out <= 60.0; out += 5.0) {
          const double is = ReflectanceOf(surface, kNormal, Direction(in), Direction(out)),
                       ggx = ReflectanceOf({.roughness = static_cast<float>(roughness)}, kNormal, Direction(in),
                                           Direction(out));
          square += is * is;
          own += ggx * ggx;
          both += is * ggx;
        }
    best = std::min(best, std::sqrt(std::max(0.0, 1.0 - both * both / (own * square))));  // strength both / own
  }
  return best;
}

TEST(SurfaceReflection, NoSingleGgxIsTheFace) {
  // A judge of the fitter, which fits one GGX to the whole face, must not be one.
  EXPECT_LT(ResidualOfOneGgx({OfFace(SkinSurface::kGgx, 0.0)}), 0.01) << "the search finds what is there";
  const SurfaceReflection dry = OfFace(SkinSurface::kTwoLobes, 0.0), oily = OfFace(SkinSurface::kTwoLobes, 1.0);
  const double of_dry = ResidualOfOneGgx({dry}), of_oily = ResidualOfOneGgx({oily}),
               of_one = ResidualOfOneGgx({OfFace(SkinSurface::kBeckmann, 0.0)}),
               of_face = ResidualOfOneGgx({dry, oily});
  std::printf("one GGX misses: one lobe %.3f, two lobes %.3f dry, %.3f oily, both %.3f\n", of_one, of_dry, of_oily,
              of_face);
  EXPECT_GT(of_one, 0.10);
  EXPECT_GT(of_dry, 0.08);
  EXPECT_GT(of_oily, 0.05);
  EXPECT_GT(of_face, 0.25);
}

TEST(FaceSurface, OfAnEvenBodyIsTheFittersForm) {
  const SurfaceReflection plain = FaceSurface(SurfaceDescription::Even()).At(0.0, -64.0), stated;
  EXPECT_EQ(plain.form, FacetForm::kGgx);
  EXPECT_EQ(plain.strength, 1.0F);
  EXPECT_EQ(plain.roughness, 0.35F);
  EXPECT_EQ(plain.fuzz_depth, 0.0F);
  const Vector3d in = Direction(50), out = Direction(30, 140);
  EXPECT_EQ(ReflectanceOf(plain, kNormal, in, out), ReflectanceOf(stated, kNormal, in, out));
}

TEST(FaceSurface, OfAHeadWhereNothingIsSaidIsNotTheFittersForm) {
  EXPECT_EQ(SceneDescription().surface.form, SkinSurface::kTwoLobes);
  const SurfaceReflection forehead = FaceSurface({}).At(0.0, -64.0), cheek = FaceSurface({}).At(45.0, 16.0);
  EXPECT_GT(ResidualOfOneGgx({forehead, cheek}), 0.15);
  for (const ShapeKind shape : {ShapeKind::kPlane, ShapeKind::kSphere, ShapeKind::kMesh})
    EXPECT_EQ(SceneDescription::Of(shape).surface.form, SkinSurface::kGgx);
}

TEST(FaceSurface, OfAllFormsHasTheSlopesOfOne) {
  for (const double oiliness : {0.0, 0.4, 1.0}) {
    const SurfaceReflection two = OfFace(SkinSurface::kTwoLobes, oiliness),
                            one = OfFace(SkinSurface::kBeckmann, oiliness), ggx = OfFace(SkinSurface::kGgx, oiliness);
    const double mean_square =
        (1.0 - two.wide_share) * std::pow(two.roughness, 2) + two.wide_share * std::pow(two.wide_roughness, 2);
    EXPECT_NEAR(one.roughness, std::sqrt(mean_square), 1e-6);
    EXPECT_NEAR(ggx.roughness / one.roughness, 1.0, 0.002);
    EXPECT_GE(one.roughness, 0.25) << "Weyrich et al. 2006";
    EXPECT_LE(one.roughness, 0.4);
    // The same Fresnel reflection along the normal: GGX's is 0.028, rounded from ((n - 1) / (n + 1))^2.
    EXPECT_NEAR(ggx.strength * 0.028 / FresnelOf(1.0, one.index), 1.0, 0.01);
  }
}

TEST(FaceSurface, ShinesOnForeheadNoseAndChin) {
  for (const auto& [x, y] : {std::pair{0.0, -64.0}, {25.0, -60.0}, {0.0, 19.0}, {0.0, 79.0}})
    EXPECT_GT(SebumAt(x, y), 0.6) << x << ", " << y;
  for (const auto& [x, y] : {std::pair{45.0, 16.0}, {-45.0, 30.0}, {50.0, -10.0}, {31.0, -20.0}, {0.0, 48.0}})
    EXPECT_LT(SebumAt(x, y), 0.15) << x << ", " << y;
  // Without a step anywhere: a millimetre changes it by a tenth at most.
  for (double x = -80; x < 80; x += 1)
    for (double y = -100; y < 100; y += 1) {
      ASSERT_LT(std::abs(SebumAt(x + 1, y) - SebumAt(x, y)), 0.1);
      ASSERT_LT(std::abs(SebumAt(x, y + 1) - SebumAt(x, y)), 0.1);
      ASSERT_LE(SebumAt(x, y), 1.0);
    }
  const FaceSurface oily({.form = SkinSurface::kTwoLobes, .oiliness = 1.0});
  const Vector3d in = Direction(20), mirror = Direction(20, 180);
  EXPECT_GT(ReflectanceOf(oily.At(0, -64), kNormal, in, mirror),
            2.0 * ReflectanceOf(oily.At(45, 16), kNormal, in, mirror));
  EXPECT_GT(Returned(oily.At(0, -64), in), 1.3 * Returned(oily.At(45, 16), in));
  const FaceSurface even({.form = SkinSurface::kTwoLobes, .oiliness = 0.0});
  EXPECT_EQ(ReflectanceOf(even.At(0, -64), kNormal, in, mirror), ReflectanceOf(even.At(45, 16), kNormal, in, mirror));
}

}  // namespace
}  // namespace stratalux::rig
