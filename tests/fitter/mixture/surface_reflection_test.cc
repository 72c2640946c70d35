// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/surface_reflection.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/shift_law.h"
#include "shared/base/random.h"
#include "shared/units/angle.h"
#include "tests/fitter/mixture/profile_directions.h"

namespace stratalux::fit {
namespace {

constexpr double kEta = 1.4, kFresnel = (0.4 / 2.4) * (0.4 / 2.4);

Eigen::Vector3d Direction(double theta, double phi) {
  return {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)};
}

double Reflectance(double roughness, const Eigen::Vector3d& lamp, const Eigen::Vector3d& eye) {
  return ReflectanceOf({1.0, roughness}, ReflectionAngles::Between(lamp, eye, Eigen::Vector3d::UnitZ()), kEta);
}

TEST(SurfaceReflection, AtTheMirrorIsTheLobesPeak) {
  // D = 1 / (pi a^2), no shadowing: pi f_r = F0 / (4 a^2).
  EXPECT_NEAR(Reflectance(0.35, Eigen::Vector3d::UnitZ(), Eigen::Vector3d::UnitZ()), kFresnel / (4.0 * 0.35 * 0.35),
              1e-12);
}

TEST(SurfaceReflection, IsReciprocal) {
  Random random(3);
  for (int k = 0; k < 100; ++k) {
    const auto any = [&] { return Direction(1.4 * random.Uniform(), 6.28 * random.Uniform()); };
    const Eigen::Vector3d a = any(), b = any();
    EXPECT_NEAR(Reflectance(0.3, a, b), Reflectance(0.3, b, a), 1e-12);
  }
}

TEST(SurfaceReflection, OfASmoothSurfaceReturnsFresnelsShare) {
  // Integral of f_r cos over the hemisphere; at 0.15 masking takes some three per cent.
  const Eigen::Vector3d lamp = Direction(0.3, 0.0);
  constexpr int kSteps = 600;
  double sum = 0.0;
  for (int i = 0; i < kSteps; ++i)
    for (int j = 0; j < kSteps; ++j) {
      const double theta = (i + 0.5) * std::numbers::pi / 2 / kSteps, phi = (j + 0.5) * 2 * std::numbers::pi / kSteps;
      sum += Reflectance(0.15, lamp, Direction(theta, phi)) / std::numbers::pi * std::cos(theta) * std::sin(theta);
    }
  sum *= std::numbers::pi / 2 / kSteps * 2 * std::numbers::pi / kSteps;
  EXPECT_NEAR(sum, kFresnel, 0.04 * kFresnel);
}

TEST(SurfaceReflection, IsNothingBehindTheHorizon) {
  EXPECT_EQ(Reflectance(0.3, Direction(1.7, 0.0), Eigen::Vector3d::UnitZ()), 0.0);
}

TEST(SurfaceReflection, FollowsTheCurveBetweenItsNodes) {
  SurfaceReflection drawn{1.0, 0.35};
  drawn.over_ggx[1] = 2.0;  // of facets that tilt by 5 degrees
  drawn.over_ggx.back() = 0.5;
  const auto over_ggx = [&](double tilt_deg) {
    const Eigen::Vector3d half = Direction(RadFromDeg(tilt_deg), 0.0);  // lamp and eye stand there
    return ReflectanceOf(drawn, ReflectionAngles::Between(half, half, Eigen::Vector3d::UnitZ()), kEta) /
           Reflectance(0.35, half, half);
  };
  EXPECT_NEAR(over_ggx(0.0), 1.0, 1e-12);
  EXPECT_NEAR(over_ggx(2.0), 1.4, 1e-9);
  EXPECT_NEAR(over_ggx(5.0), 2.0, 1e-9);
  EXPECT_NEAR(over_ggx(7.5), 1.5, 1e-9);
  EXPECT_NEAR(over_ggx(65.0), 0.75, 1e-9);
  EXPECT_NEAR(over_ggx(75.0), 0.5, 1e-9);
  EXPECT_NEAR(over_ggx(88.0), 0.5, 1e-9);
}

TEST(SurfaceReflection, OfHairsGoesAsBothCosinesInverseAndIsHeldAtTheHorizon) {
  const SurfaceReflection hairs{.strength = 0.0, .hairs = 0.002};
  const auto of = [&](double lamp, double eye) {
    return ReflectanceOf(
        hairs, ReflectionAngles::Between(Direction(lamp, 0.3), Direction(eye, 2.0), Eigen::Vector3d::UnitZ()), kEta);
  };
  EXPECT_NEAR(of(0.0, 0.0), 0.002, 1e-12);
  EXPECT_NEAR(of(1.0, 0.7), 0.002 / (std::cos(1.0) * std::cos(0.7)), 1e-12);
  EXPECT_EQ(of(1.5, 0.0), of(1.52, 0.0));
}

// Facets in two Beckmann lobes that mask each other as grooves do, and hairs: nothing that GGX is, as skin is nothing.
// Where it is oily, the grooves are filled: more of the flat lobe.
double GroovedSkin(const ReflectionAngles& a, double oil = 0.0) {
  const double cos2 = a.normal_half * a.normal_half, tan2 = (1.0 - cos2) / cos2;
  const auto lobe = [&](double slope) { return std::exp(-tan2 / (slope * slope)) / (slope * slope * cos2 * cos2); };
  const double flat = 0.35 + 0.25 * oil, facets = flat * lobe(0.17) + (1.0 - flat) * lobe(0.4);
  const double grooves = std::min(1.0, 2.0 * a.normal_half * std::min(a.normal_in, a.normal_out) / a.half_in);
  const double fresnel = kFresnel + (1.0 - kFresnel) * std::pow(1.0 - a.half_in, 5);
  return ((1.2 + 0.2 * oil) * facets * grooves * fresnel / 4.0 + 0.003) / (a.normal_in * a.normal_out);
}

// White frames of a sphere's front seen from afar, three colours: layers of any albedo, gain, few events, surface.
struct Sphere {
  double strength = 1.0, roughness = 0.35, tau = 0.2;
  std::array<double, 3> few = {0.1, 0.15, 0.2};
  double noise = 0.0;     // of each light, relative
  double shadowed = 0.0;  // share of the lights that something else halves
  bool grooved = false;   // GroovedSkin in place of GGX
  bool oily = false;      // about kOily

  [[nodiscard]] std::vector<SrdBatch> Lights(const std::vector<Eigen::Vector3d>& lamps) const {
    Random random(7);
    std::vector<SrdBatch> lights(lamps.size());
    std::vector<double> albedo;
    for (int k = 0; k < 3 * kSide * kSide; ++k)
      albedo.push_back((k % 3 == 0 ? 0.45 : 0.2) * (0.8 + 0.4 * random.Uniform()));
    for (size_t p = 0; p < lamps.size(); ++p)
      for (int k = 0; k < kSide * kSide; ++k) {
        const double x = (k % kSide + 0.5) / kSide * 1.6 - 0.8, y = (k / kSide + 0.5) / kSide * 1.6 - 0.8;
        if (x * x + y * y > 0.8) continue;
        for (int c = 0; c < 3; ++c)
          AddProfile({x, y, std::sqrt(1.0 - x * x - y * y)}, lamps[p], c, albedo[3 * k + c], random, lights[p]);
        for (int c = 0; c < 3; ++c)
          lights[p].place.push_back(3 * ((k / kSide + kMargin) * kWidth + k % kSide + kMargin) + c);
      }
    return lights;
  }
  static ProfileGrid Grid() { return {kWidth, kWidth, 3, 2.0}; }
  // A profile that shows the sphere there.
  static int64_t PlaceOf(const Eigen::Vector3d& normal) {
    const auto at = [](double x) { return static_cast<int64_t>((x + 0.8) / 1.6 * kSide); };
    return 3 * ((at(normal.y()) + kMargin) * kWidth + at(normal.x()) + kMargin);
  }

  [[nodiscard]] double Reflected(const ReflectionAngles& angles, const Eigen::Vector3d& normal) const {
    const double oil = oily ? std::exp(-(normal - kOily).squaredNorm() / (2.0 * 0.2 * 0.2)) : 0.0;
    return grooved ? GroovedSkin(angles, oil) : ReflectanceOf({strength, roughness}, angles, kEta);
  }
  inline static const Eigen::Vector3d kOily = Eigen::Vector3d(0.1, 0.25, 1.0).normalized();

 private:
  static constexpr int kSide = 40, kMargin = 13, kWidth = kSide + 2 * kMargin;  // of the map about the sphere

  void AddProfile(const Eigen::Vector3d& normal, const Eigen::Vector3d& lamp, int c, double albedo, Random& random,
                  SrdBatch& b) const {
    const Eigen::Vector3d eye = Eigen::Vector3d::UnitZ();
    b.samples = 3;
    test::AddDirections(lamp, eye, normal, Eigen::Vector3d::UnitY().cross(normal).normalized(), b);
    b.step_mm.push_back(0.5F);
    b.line_width_mm.push_back(1.0F);  // a cycle adds up to two whites
    b.first_u_mm.push_back(0.0F);
    b.valid.push_back(normal.dot(lamp) > 0.1 ? 1 : 0);
    double white = 0.0;
    if (b.valid.back() != 0) {
      const RefractedDirections d = DirectionsOf(lamp, eye, normal, kEta);
      const double events = d.sec_in * d.sec_out * std::exp(1.15 * (1.0 + d.cos_scatter));
      white = albedo * AngularGain(normal.dot(lamp), kEta, tau) * (1.0 + few[c] * (events - 1.0)) +
              Reflected(ReflectionAngles::Between(lamp, eye, normal), normal);
      white *= 1.0 + noise * random.Normal();
      if (random.Uniform() < shadowed) white *= 0.5;
    }
    b.white.push_back(static_cast<float>(2.0 * white));
    b.white_variance.push_back(static_cast<float>(std::pow(2.0 * noise * white, 2) + 1e-10));
    b.y.insert(b.y.end(), 3, static_cast<float>(2.0 * white / 3.0));
    b.noise_floor.push_back(1e-6F);
    b.noise_slope.push_back(0.0F);
  }
};

const std::vector<Eigen::Vector3d>& ThreeLamps() {
  static const std::vector<Eigen::Vector3d> lamps = {Direction(0.6, 0.0), Direction(0.6, 2.1), Direction(0.6, 4.2)};
  return lamps;
}

SurfaceReflection Estimate(const std::vector<SrdBatch>& lights, const ProfileGrid& grid = {.channels = 3}) {
  std::vector<const SrdBatch*> pointers;
  for (const SrdBatch& b : lights) pointers.push_back(&b);
  return EstimateSurfaceReflection(pointers, grid, kEta, 1);
}

class EstimateSurfaceReflectionTest : public testing::TestWithParam<Sphere> {};

TEST_P(EstimateSurfaceReflectionTest, FindsStrengthAndRoughness) {
  const Sphere& sphere = GetParam();
  const double tolerance = sphere.shadowed > 0.0 ? 0.1 : sphere.noise > 0.0 ? 0.06 : 0.005;
  const SurfaceReflection found = Estimate(sphere.Lights(ThreeLamps()));
  EXPECT_NEAR(found.strength, sphere.strength, tolerance * sphere.strength);
  EXPECT_NEAR(found.roughness, sphere.roughness, tolerance * sphere.roughness);
}

INSTANTIATE_TEST_SUITE_P(Spheres, EstimateSurfaceReflectionTest,
                         testing::Values(Sphere{}, Sphere{0.5, 0.25, 0.0, {0.0, 0.0, 0.0}},
                                         Sphere{1.6, 0.45, 0.5, {0.3, 0.2, 0.1}},
                                         Sphere{1.0, 0.35, -0.2, {0.1, 0.15, 0.2}},
                                         Sphere{1.0, 0.35, 0.2, {0.1, 0.15, 0.2}, 0.02},
                                         Sphere{1.0, 0.35, 0.2, {0.1, 0.15, 0.2}, 0.02, 0.05}));

// Relative error (rms) of what is found, under lamps that it was not found by; as it is found, and by its GGX alone.
struct ErrorElsewhere {
  double curve = 0.0, ggx = 0.0;
};
ErrorElsewhere ErrorUnderOtherLamps(const Sphere& sphere, const SurfaceReflection& found) {
  const SurfaceReflection ggx{found.strength, found.roughness};
  Random random(5);
  double curve = 0.0, alone = 0.0, square = 0.0;
  for (int k = 0; k < 20000; ++k) {
    const Eigen::Vector3d normal = Direction(random.Uniform(), 6.28 * random.Uniform()), eye(0.0, 0.0, 1.0),
                          lamp = Direction(0.6, 6.28 * random.Uniform());
    const ReflectionAngles angles = ReflectionAngles::Between(lamp, eye, normal);
    if (!(angles.normal_in > 0.3)) continue;
    const double truth = sphere.Reflected(angles, normal);
    curve += std::pow(ReflectanceOf(found, angles, kEta) - truth, 2);
    alone += std::pow(ReflectanceOf(ggx, angles, kEta) - truth, 2);
    square += truth * truth;
  }
  return {std::sqrt(curve / square), std::sqrt(alone / square)};
}

TEST(EstimateSurfaceReflection, DrawsWhatNoGgxIs) {
  const Sphere skin{.noise = 0.02, .grooved = true};
  const ErrorElsewhere error = ErrorUnderOtherLamps(skin, Estimate(skin.Lights(ThreeLamps())));
  EXPECT_LT(error.curve, 0.04);
  EXPECT_GT(error.ggx, 3.0 * error.curve);
}

// Error, relative (rms), of what oily skin mirrors of lamps from all sides.
double ErrorWhereOily(const Sphere& sphere, const SurfaceReflection& found) {
  const Eigen::Vector3d normal = Sphere::kOily, eye(0.0, 0.0, 1.0);
  double square = 0.0, truth = 0.0;
  for (int k = 0; k < 400; ++k) {
    const auto angles = ReflectionAngles::Between(Direction(0.02 * (k % 40), 0.628 * (k / 40)), eye, normal);
    const double there = sphere.Reflected(angles, normal);
    square += std::pow(ReflectanceOf(found, angles, kEta, found.gloss.At(Sphere::PlaceOf(normal))) - there, 2);
    truth += there * there;
  }
  return std::sqrt(square / truth);
}

TEST(EstimateSurfaceReflection, FindsWhereSkinIsGlossier) {
  const Sphere skin{.noise = 0.02, .grooved = true, .oily = true};
  const auto lights = skin.Lights(ThreeLamps());
  const SurfaceReflection found = Estimate(lights, Sphere::Grid()), even = Estimate(lights);
  ASSERT_FALSE(found.gloss.nodes.empty());
  EXPECT_TRUE(even.gloss.nodes.empty());
  EXPECT_LT(ErrorWhereOily(skin, found), 0.75 * ErrorWhereOily(skin, even));
  const double oily = found.gloss.At(Sphere::PlaceOf(Sphere::kOily));
  for (const double x : {-0.6, 0.6})
    EXPECT_LT(found.gloss.At(Sphere::PlaceOf(Eigen::Vector3d(x, -0.4, 0.7))), 0.2 * oily) << x;
}

// A session finds it once for all surfaces that it places.
TEST(EstimateSurfaceReflection, IsTheSameWhereverTheSurfaceIsPlaced) {
  const Sphere skin{.noise = 0.02, .grooved = true, .oily = true};
  auto lights = skin.Lights(ThreeLamps());
  const SurfaceReflection before = Estimate(lights, Sphere::Grid());
  for (SrdBatch& light : lights)
    for (size_t i = 0; i < light.first_u_mm.size(); ++i) light.first_u_mm[i] += 0.13F * light.slope_in[i];
  const SurfaceReflection after = Estimate(lights, Sphere::Grid());
  ASSERT_FALSE(before.gloss.nodes.empty());
  EXPECT_EQ(after.gloss.nodes, before.gloss.nodes);
  EXPECT_EQ(after.by_gloss, before.by_gloss);
}

TEST(HeldReflection, OfAPartOfAMapHasTheGlossOfItsPlaces) {
  const std::vector<SrdBatch> lights = Sphere{}.Lights(ThreeLamps());
  SurfaceReflection glossy{1.0, 0.35};
  glossy.by_gloss.fill(0.8);
  glossy.gloss = FlatGloss(Sphere::Grid());
  for (size_t k = 0; k < glossy.gloss.nodes.size(); ++k) glossy.gloss.nodes[k] = 0.1 * static_cast<double>(k);
  const std::vector<int64_t> which = {2000, 7, 1234};
  const SrdBatch part = ProfilesOf(lights[0], which);
  for (size_t k = 0; k < which.size(); ++k) {
    const double whole = HeldReflection(glossy, lights[0], which[k], kEta);
    EXPECT_EQ(HeldReflection(glossy, part, static_cast<int64_t>(k), kEta), whole);
    const double gloss = glossy.gloss.At(lights[0].PlaceOf(which[k]));
    EXPECT_NEAR(ReflectedBy(glossy, part, static_cast<int64_t>(k), kEta),
                (1.0 + 0.8 * gloss) * ReflectedBy({1.0, 0.35}, part, static_cast<int64_t>(k), kEta), 1e-12);
  }
}

TEST(EstimateSurfaceReflection, OfEvenSkinHasNoGloss) {
  for (const bool grooved : {true, false}) {
    const Sphere skin{.noise = 0.02, .grooved = grooved};
    EXPECT_TRUE(Estimate(skin.Lights(ThreeLamps()), Sphere::Grid()).gloss.nodes.empty()) << grooved;
  }
}

TEST(EstimateSurfaceReflection, OfGgxDrawsNothing) {
  const Sphere skin{.noise = 0.02};
  const SurfaceReflection found = Estimate(skin.Lights(ThreeLamps()));
  EXPECT_EQ(found.over_ggx, SurfaceReflection{}.over_ggx);
  EXPECT_EQ(found.hairs, 0.0);
  EXPECT_LT(ErrorUnderOtherLamps(skin, found).curve, 0.05);
}

TEST(EstimateSurfaceReflection, OfAMattSphereIsNearNothing) {
  Sphere matt;
  matt.strength = 0.0;
  const SurfaceReflection found = Estimate(matt.Lights(ThreeLamps()));
  EXPECT_TRUE(found.Known());
  EXPECT_LT(found.strength, 0.01);
}

TEST(EstimateSurfaceReflection, OneLightTellsNothing) {
  EXPECT_FALSE(Estimate(Sphere{}.Lights({Direction(0.6, 0.0)})).Known());
}

// Columns and rows of one lamp.
TEST(EstimateSurfaceReflection, OneLightTwiceTellsNothing) {
  EXPECT_FALSE(Estimate(Sphere{}.Lights({Direction(0.6, 0.0), Direction(0.6, 0.0)})).Known());
}

TEST(EstimateSurfaceReflection, UnknownReflectsNothing) { EXPECT_EQ(ReflectanceOf({}, ReflectionAngles{}, kEta), 0.0); }

TEST(EstimateSurfaceReflection, ValuesThatAreNotFiniteHaveNoPart) {
  auto lights = Sphere{}.Lights(ThreeLamps());
  for (size_t i = 0; i < lights[1].white.size(); i += 5) lights[1].white[i] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_NEAR(Estimate(lights).strength, 1.0, 0.01);
}

class WhiteReflectanceOfTest : public testing::TestWithParam<bool> {};

TEST_P(WhiteReflectanceOfTest, WithoutWhiteFramesIsTheCyclesSum) {
  auto lights = Sphere{}.Lights(ThreeLamps());
  lights[0].wrapped = GetParam();
  const double of_frames = WhiteReflectanceOf(lights[0], 600).value;
  lights[0].white.clear();
  EXPECT_NEAR(WhiteReflectanceOf(lights[0], 600).value, of_frames, 1e-6);
}

INSTANTIATE_TEST_SUITE_P(GatheredAndScattered, WhiteReflectanceOfTest, testing::Bool());

// As hair among skin: it shines as nothing else of the face does, and is no part of it.
TEST(EstimateSurfaceReflection, TakesNoNoticeOfProfilesThatStandApart) {
  const Sphere skin, wet{.strength = 3.0, .roughness = 0.2};
  const auto of_skin = skin.Lights(ThreeLamps()), of_wet = wet.Lights(ThreeLamps());
  std::vector<int64_t> rest;
  const auto is_wet = [](int64_t i) { return i / 3 % 4 == 2; };
  for (int64_t i = 0; i < of_skin[0].profiles(); ++i)
    if (!is_wet(i)) rest.push_back(i);
  auto mixed = of_skin;
  std::vector<SrdBatch> alone;
  for (size_t p = 0; p < mixed.size(); ++p) {
    for (int64_t i = 0; i < mixed[p].profiles(); ++i) {
      if (is_wet(i)) {
        std::ranges::copy(of_wet[p].Samples(i), mixed[p].Samples(i).begin());
        if (!mixed[p].white.empty()) mixed[p].white[i] = of_wet[p].white[i];
      }
      mixed[p].apart.push_back(is_wet(i) ? 1 : 0);
    }
    alone.push_back(ProfilesOf(of_skin[p], rest));
  }
  const SurfaceReflection apart = Estimate(mixed), without = Estimate(alone);
  ASSERT_TRUE(apart.Known() && without.Known());
  EXPECT_NEAR(apart.strength, without.strength, 1e-9);
  EXPECT_NEAR(apart.roughness, without.roughness, 1e-9);
  for (SrdBatch& batch : mixed) batch.apart.clear();
  EXPECT_GT(std::abs(Estimate(mixed).strength - without.strength), 0.01);
}

}  // namespace
}  // namespace stratalux::fit
