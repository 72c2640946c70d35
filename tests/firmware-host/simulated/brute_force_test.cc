// SPDX-License-Identifier: Apache-2.0
// The simulated rig's light against photons that took another route: see brute_force.h.
#include "tests/firmware-host/simulated/brute_force.h"

#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "shared/units/angle.h"
#include "tests/firmware-host/simulated/brute_force_frames.h"
#include "tests/firmware-host/simulated/flat_world.h"
#include "tests/firmware-host/simulated/plain_patterns.h"

namespace stratalux::rig {
namespace {

TEST(BruteForce, WhiteLightOnAPlaneIsTheLayeredMonteCarlos) {
  // The two Monte Carlos share no line: forward photons into a cone around the view against connected backward photons.
  for (const int colour : {0, 2}) {
    const FlatWorldOptions options{.light_deg = 40.0, .cfa = Cfa::kRggb};
    const FlatWorld world(options);
    SubjectPixel pixel = world.Pixel();  // even coordinates: red
    if (colour == 2) pixel = world.Pixel(1, 1);
    ASSERT_EQ(CfaColour(Cfa::kRggb, pixel.x, pixel.y), colour);
    const std::vector<ProjectedLight> lights = {{0, kWhitePattern}};
    const auto traced = TracePixel(world.scene(), world.rig(), pixel.x, pixel.y, lights, {.photons = 4000});

    MonteCarloOptions forward;
    forward.photons = 60000;
    forward.seed = 4;
    forward.sin2_theta_low = forward.sin2_theta_high = std::pow(std::sin(RadFromDeg(40.0)), 2);
    double sum = 0.0, squares = 0.0;
    forward.threads = 1;
    const double cos2 = std::pow(std::cos(RadFromDeg(20.0)), 2);
    TraceLayeredTissue(AbsorbingSkin(colour, options.skin), forward, [&](int64_t, std::span<const EscapedPhoton> list) {
      for (const EscapedPhoton& e : list) {
        if (e.uz * e.uz < cos2) continue;
        sum += e.weight;
        squares += e.weight * e.weight;
      }
    });
    // pi radiance over irradiance: flux into the cone over its projected solid angle / pi.
    const double scale = 1.0 / (static_cast<double>(forward.photons) * (1.0 - cos2));
    const double expected = sum * scale, error = std::sqrt(squares) * scale;
    const double irradiance = world.Irradiance(pixel.point, colour);
    const double mean = traced[0].subsurface / irradiance, own = traced[0].subsurface_error / irradiance;
    std::printf("colour %d: backward %.4f +- %.4f, forward %.4f +- %.4f\n", colour, mean, own, expected, error);
    EXPECT_LT(own, 0.03 * mean);
    EXPECT_NEAR(mean, expected, 3.5 * std::hypot(own, error)) << colour;
  }
}

TEST(BruteForce, SurfaceOfTheRigIsThatOfThePhotons) {
  // Formulas written apart: density of slopes and quadratures there, closed forms in the rig. The photons start all
  // over the pixel's footprint, the rig takes its middle.
  for (const SkinSurface form : {SkinSurface::kGgx, SkinSurface::kBeckmann, SkinSurface::kTwoLobes})
    for (const double light_deg : {-25.0, 10.0, 65.0}) {
      const FlatWorld world({.light_deg = light_deg});
      SceneDescription description = *SceneOfName("plane");
      description.surface = {.form = form, .oiliness = 0.7, .fuzz = 1.0};
      const Scene scene = *Scene::Create(description, 1);
      SubjectPixel pixel = world.Pixel();
      pixel.material = scene.MaterialAt(pixel.point);
      const std::vector<SubjectPixel> pixels = {pixel};
      std::vector<float> subsurface(1, 0.0F), direct(1, 0.0F);
      LightTransport(scene, world.table(), world.albedo(), world.rig(), 0, pixels, {})
          .Render(kWhitePattern, subsurface, direct);
      const std::vector<ProjectedLight> lights = {{0, kWhitePattern}};
      const auto traced = TracePixel(scene, world.rig(), pixel.x, pixel.y, lights, {.photons = 400});
      EXPECT_GT(traced[0].direct, 0.005 * world.Irradiance(pixel.point, 0));
      EXPECT_NEAR(direct[0] / traced[0].direct, 1.0, 0.003 + 4.0 * traced[0].direct_error / traced[0].direct)
          << static_cast<int>(form) << ", " << light_deg;
    }
}

TEST(BruteForce, FramesOfTheRigAreThoseOfThePhotons) {
  // White, stripe and spot of two projectors on six pixels of the head, two places in three colours. The long run and
  // what it found: docs/simulated-rig.md.
  CompareOptions options;
  options.rig.camera_width = 174;
  options.rig.camera_height = 130;
  options.rig.projector_width = 512;
  options.rig.projector_height = 384;
  options.exposure_ms = 32.0;
  options.tracing = {.photons = 3000, .seed = 2};
  Logger logger(LogLevel::kWarning);
  const auto compared =
      CompareWithRig(options, CrossCheckLights(options.rig), CrossCheckPixels(options.rig, 2), logger);
  ASSERT_TRUE(compared.ok()) << compared.status().message();
  ASSERT_EQ(compared->size(), 36U);
  std::fputs(ComparisonTable(*compared).c_str(), stdout);
  double chi2 = 0.0, white = 0.0;
  for (const ComparedPixel& c : *compared) {
    const double sigma = SigmaOf(c, options.exposure_ms);
    EXPECT_NEAR(c.rig, c.traced, 4.0 * sigma) << c.light << " of " << c.projector << " at " << c.x << ", " << c.y;
    chi2 += std::pow((c.rig - c.traced) / sigma, 2);
    if (c.light == "white") white += c.Deviation() / 12.0;
  }
  EXPECT_LT(chi2 / 36.0, 1.5);
  EXPECT_LT(std::abs(white), 0.025);
}

}  // namespace
}  // namespace stratalux::rig
