// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/mlsss.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <gtest/gtest.h>

#include "fitter/mixture/shift_law.h"
#include "fitter/render/surface_light.h"
#include "shared/geometry/pixel_box.h"
#include "shared/geometry/quad.h"
#include "tests/fitter/render/lit_scene.h"

namespace stratalux::fit {
namespace {

const Eigen::Vector3d kAtCamera(0.0, 0.0, 0.0);
const Eigen::Vector3d kFromLeft(-350.0, 0.0, 150.0);  // 45 degrees
const Pattern kWhite{.kind = PatternKind::kWhite};
const Pattern kSpots{.kind = PatternKind::kSpots, .period = 40, .width = 4};

Image<float> Render(const LitScene& scene, const MixtureMap& map, const Pattern& pattern, double scale = 1.0) {
  const std::vector<LitPyramid> lights = {LightWith(scene.lit, pattern, scale)};
  return RenderSubsurface(map, scene.surface, scene.rig, scene.lit, lights).front();
}

Image<float> Reference(const LitScene& scene, const MixtureMap& map, const Pattern& pattern) {
  return RenderSubsurfaceReference(map, scene.surface, scene.rig, LightWith(scene.lit, pattern), scene.lit);
}

// A surface of reflectance `reflectance` under a pattern.
Image<float> RenderSurface(const LitScene& scene, const Image<float>& reflectance, const Pattern& pattern) {
  const std::vector<LitPyramid> lights = {LightWith(scene.lit, pattern)};
  return ReflectedLight(reflectance, SurfaceIrradiance(scene.surface, scene.rig, scene.lit, lights).front());
}

double Phi(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

float Maximum(const Image<float>& image) { return *std::max_element(image.pixels().begin(), image.pixels().end()); }

float LargestDifference(const Image<float>& a, const Image<float>& b) {
  float largest = 0.0F;
  for (size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::abs(a.pixels()[i] - b.pixels()[i]));
  return largest;
}

// Mean x in mm of the light in the middle row.
double CentroidX(const LitScene& scene, const Image<float>& image, int channel = 0) {
  double sum = 0.0, moment = 0.0;
  const int j = image.height() / 2;
  for (int i = 0; i < image.width(); ++i) {
    sum += image(i, j, channel);
    moment += image(i, j, channel) * scene.surface.point_mm(i, j, 0);
  }
  return moment / sum;
}

TEST(RenderSubsurface, ReflectsTheSumOfTheWeightsUnderUniformLight) {
  // The integral of each Gaussian is 1: energy is kept, whatever widths, depths and sampling.
  for (const Eigen::Vector3d& lamp : {kAtCamera, kFromLeft}) {
    const LitScene scene = MakeScene(FrontalPlane(), lamp);
    const MixtureMap map = UniformSkin(scene, {{0.1F, 0.2F, 0.3F}, {0.2F, 0.5F, 0.9F}, {0.15F, 0.9F, 2.5F}});
    const Image<float> image = Render(scene, map, kWhite);
    const ProjectorCalibration& light = scene.rig.projectors[0];
    for (int j = 15; j < 21; ++j)
      for (int i = 20; i < 28; ++i) {
        const Eigen::Vector3d p = scene.surface.Point(i, j), n = scene.surface.Normal(i, j);
        const double gain =
            AngularGain(n.dot((light.CentreInCamera() - p).normalized()), map.scattering.eta, map.scattering.tau);
        const double white = light.WhiteTargetDn(p, n, 0, kExposureMs);
        EXPECT_NEAR(image(i, j) / (0.45 * gain * white), 1.0, 0.01) << i << ", " << j;
      }
  }
}

TEST(RenderSubsurface, KeepsTheEnergyOfLayersNarrowerThanAnyPixel) {
  for (const Eigen::Vector3d& lamp : {kAtCamera, kFromLeft}) {
    const LitScene scene = MakeScene(FrontalPlane(), lamp);
    const MixtureMap map = UniformSkin(scene, {{0.3F, 0.0F, 0.01F}});
    const Image<float> image = Render(scene, map, kWhite);
    const ProjectorCalibration& light = scene.rig.projectors[0];
    for (int j = 10; j < 26; ++j)
      for (int i = 14; i < 34; ++i) {
        const Eigen::Vector3d p = scene.surface.Point(i, j), n = scene.surface.Normal(i, j);
        const double gain =
            AngularGain(n.dot((light.CentreInCamera() - p).normalized()), map.scattering.eta, map.scattering.tau);
        EXPECT_NEAR(image(i, j) / (0.3 * gain * light.WhiteTargetDn(p, n, 0, kExposureMs)), 1.0, 0.01);
      }
  }
}

// Line light on a plane: model section 7's mixture, Gaussians through the box of the line.
struct LineOnPlane {
  double left_mm, right_mm, blur_mm;  // edges of the line in the plane, the projector's blur there

  LineOnPlane(const LitScene& scene, int columns) {
    const ProjectorCalibration& light = scene.rig.projectors[0];
    auto x_of = [&](double column) {
      const Eigen::Vector3d ray = light.camera_from_projector.rotation * light.model.Unproject({column, 59.5});
      return light.CentreInCamera().x() + ray.x() / ray.z() * (kDistanceMm - light.CentreInCamera().z());
    };
    left_mm = x_of(79.5 - 0.5 * columns);
    right_mm = x_of(79.5 + 0.5 * columns);
    blur_mm = light.line_blur_px * (right_mm - left_mm) / columns;
  }

  [[nodiscard]] double Dn(const LitScene& scene, const std::vector<Layer>& layers, const MixtureMap& map, int i,
                          int j) const {
    const ProjectorCalibration& light = scene.rig.projectors[0];
    const Eigen::Vector3d p = scene.surface.Point(i, j), to_lamp = (light.CentreInCamera() - p).normalized();
    // Both rays refracted by hand; the plane's normal is -z, so x slopes are plain ratios.
    auto refracted = [&](double outer_sine) {
      const double sine = outer_sine / map.scattering.eta;
      return sine / std::sqrt(1.0 - sine * sine);
    };
    const double shift = refracted(to_lamp.x()) - refracted(-p.normalized().x());
    constexpr int kPoints = 40;  // of the pixel's box
    double reflectance = 0.0;
    for (const Layer& l : layers)
      for (int k = 0; k < kPoints; ++k) {
        const double s = std::hypot(l.sigma_mm, blur_mm);
        const double centre = p.x() + l.depth_mm * shift + ((k + 0.5) / kPoints - 0.5) * kMosaicPixelMm;
        reflectance += l.weight / kPoints * (Phi((right_mm - centre) / s) - Phi((left_mm - centre) / s));
      }
    const Eigen::Vector3d on_line(0.5 * (left_mm + right_mm), p.y(), kDistanceMm);
    return reflectance * AngularGain(-to_lamp.z(), map.scattering.eta, map.scattering.tau) *
           light.WhiteTargetDn(on_line, {0, 0, -1}, 0, kExposureMs);
  }
};

TEST(RenderSubsurface, ShowsTheAnalyticMixtureUnderALine) {
  // Layers of skin; one narrower than the light's pixels, which seen from the side are wider than the camera's.
  for (const std::vector<Layer>& layers : {SkinLayers(), {{0.3F, 0.2F, 0.02F}}})
    for (const Eigen::Vector3d& lamp : {kAtCamera, kFromLeft})
      for (int columns : {2, 8}) {
        const LitScene scene = MakeScene(FrontalPlane(), lamp);
        const MixtureMap map = UniformSkin(scene, layers);
        const Image<float> image = Render(scene, map, MiddleLine(scene, columns));
        const LineOnPlane line(scene, columns);
        const int j = 18;  // rows in the middle see the line to both ends
        double peak = 0.0;
        for (int i = 0; i < 48; ++i) peak = std::max(peak, line.Dn(scene, layers, map, i, j));
        for (int i = 4; i < 44; ++i)
          EXPECT_NEAR(image(i, j) / peak, line.Dn(scene, layers, map, i, j) / peak, 0.01)
              << columns << " columns, " << i;
      }
}

TEST(RenderSubsurface, AveragesOverTheBoxOfAPixelThatATiltMakesLong) {
  // Seen at 70 degrees, lit from straight above: a pixel is as long as six of the light's columns.
  constexpr double kSlope = 2.75;
  constexpr float kWeight = 0.4F, kSigma = 0.3F;
  constexpr int kColumns = 2, kPoints = 200, j = 18;
  const HeightField leaning = [](double x, double) { return Height{kDistanceMm + kSlope * x, kSlope, 0.0}; };
  const Eigen::Vector3d n = Eigen::Vector3d(kSlope, 0.0, -1.0).normalized(), along = n.cross(Eigen::Vector3d::UnitY());
  const LitScene scene = MakeScene(leaning, Eigen::Vector3d(0.0, 0.0, kDistanceMm) + 400.0 * n);
  const ProjectorCalibration& light = scene.rig.projectors[0];
  const MixtureMap map = UniformSkin(scene, {{kWeight, 0.0F, kSigma}});
  const Image<float> mirror(scene.surface.width(), scene.surface.height(), 1, 1.0F);
  double worst = 0.0, worst_surface = 0.0, worst_gaussian = 0.0;
  for (int moved = 0; moved < 6; ++moved) {
    Pattern line = MiddleLine(scene, kColumns);
    line.shift += moved;
    const Image<float> skin = Render(scene, map, line), surface = RenderSurface(scene, mirror, line);
    for (int i = 4; i < 44; ++i) {
      const Eigen::Vector3d p = scene.surface.Point(i, j);
      const double white = light.WhiteTargetDn(p, n, 0, kExposureMs),
                   gain = AngularGain(n.dot((light.CentreInCamera() - p).normalized()), map.scattering.eta,
                                      map.scattering.tau);
      const auto column = [&](const Eigen::Vector3d& at) { return light.ProjectFromCamera(at)->x(); };
      const double per_mm = std::abs(column(p + along) - column(p)), optics = light.line_blur_px;
      const auto of_line = [&](double at, double sigma) {
        return Phi((79.5 + moved + 0.5 * kColumns - at) / sigma) - Phi((79.5 + moved - 0.5 * kColumns - at) / sigma);
      };
      double in_skin = 0.0, at_surface = 0.0;
      const auto meet = [&](double x) -> Eigen::Vector3d {
        const Eigen::Vector3d ray = scene.rig.camera.model.Unproject({x, double(j)});
        return ray * (n.dot(p) / n.dot(ray));
      };
      for (int k = 0; k < kPoints; ++k) {
        const double at = column(meet(i + (k + 0.5) / kPoints - 0.5));
        in_skin += of_line(at, std::hypot(optics, kSigma * per_mm)) / kPoints;
        at_surface += of_line(at, optics) / kPoints;
      }
      const double box = (column(meet(i + 0.5)) - column(meet(i - 0.5))) * std::sqrt(kBoxVariance);
      worst = std::max(worst, std::abs(skin(i, j) / (kWeight * gain * white) - in_skin));
      worst_surface = std::max(worst_surface, std::abs(surface(i, j) / white - at_surface));
      worst_gaussian = std::max(worst_gaussian, std::abs(of_line(column(p), std::hypot(optics, box)) - at_surface));
    }
  }
  // Of a line that a pixel wholly holds, a third of white.
  EXPECT_LT(worst, 0.03);
  EXPECT_LT(worst_surface, 0.04);
  EXPECT_GT(worst_gaussian, 0.07);  // what one Gaussian would be off by
}

TEST(RenderSubsurface, GlowsOnTheSideAwayFromTheLamp) {
  // Rays run deeper as they run away from the lamp: an exit point is fed from the lamp's side of it.
  const LitScene scene = MakeScene(FrontalPlane(), kFromLeft);
  const double depth = 1.2;
  for (ShiftLaw law : {ShiftLaw::kPaper, ShiftLaw::kRefracted, ShiftLaw::kRefractedSine}) {
    MixtureMap deep = UniformSkin(scene, {{0.4F, static_cast<float>(depth), 1.2F}}),
               flat = UniformSkin(scene, {{0.4F, 0.0F, 1.2F}});
    deep.scattering.shift_law = flat.scattering.shift_law = law;
    const Pattern line = MiddleLine(scene, 4);
    const double moved = CentroidX(scene, Render(scene, deep, line)) - CentroidX(scene, Render(scene, flat, line));
    const double sine = std::sqrt(0.5) / 1.4;
    const double expected = law == ShiftLaw::kPaper       ? 1.0
                            : law == ShiftLaw::kRefracted ? sine / std::sqrt(1.0 - sine * sine)
                                                          : sine;
    EXPECT_NEAR(moved, depth * expected, 0.03 * depth * expected) << ToString(law);
  }
}

TEST(RenderSubsurface, IsLinearInTheLight) {
  const LitScene scene = MakeScene(FaceLike(), kFromLeft);
  const MixtureMap map = VaryingSkin(scene, SkinLayers());
  const Image<float> once = Render(scene, map, kSpots), twice = Render(scene, map, kSpots, 2.0);
  for (size_t i = 0; i < once.size(); ++i)
    EXPECT_NEAR(twice.pixels()[i], 2.0F * once.pixels()[i], 1e-5F * Maximum(twice));
}

TEST(RenderSubsurface, AddsTheFramesOfACombCycleUpToWhite) {
  const LitScene scene = MakeScene(FaceLike(), kFromLeft);
  const MixtureMap map = VaryingSkin(scene, SkinLayers());
  const Image<float> white = Render(scene, map, kWhite);
  Image<float> sum(white.width(), white.height());
  for (int shift = 0; shift < 32; shift += 4) {
    const Image<float> frame =
        Render(scene, map, {.kind = PatternKind::kComb, .period = 32, .width = 4, .shift = shift});
    for (size_t i = 0; i < sum.size(); ++i) sum.pixels()[i] += frame.pixels()[i];
  }
  EXPECT_LT(LargestDifference(sum, white), 0.01F * Maximum(white));
}

TEST(RenderSubsurface, AgreesWithTheDoubleLoop) {
  const LitScene scene = MakeScene(FaceLike(), kFromLeft);
  const MixtureMap map = VaryingSkin(scene, SkinLayers());
  for (const Pattern& pattern : {kWhite, MiddleLine(scene, 2), MiddleLine(scene, 8), kSpots}) {
    const Image<float> fast = Render(scene, map, pattern), exact = Reference(scene, map, pattern);
    ASSERT_GT(Maximum(exact), 1.0F);
    EXPECT_LT(LargestDifference(fast, exact), 0.01F * Maximum(exact)) << pattern.ToString();
  }
}

// A red lamp, and a blue one: what they show in their colour is what white light shows in it, shadows too.
TEST(RenderSubsurface, ALightWithoutGreenShowsItsColourAsWhiteDoes) {
  const LitScene white = MakeScene(FaceLike(), kFromLeft, Cfa::kRggb);
  const MixtureMap map = VaryingSkin(white, SkinLayers());
  const Image<float> all = Render(white, map, kWhite);
  for (const int colour : {0, 2}) {
    ProjectorCalibration lamp = white.lit.light;
    for (int c = 0; c < 3; ++c)
      if (c != colour) lamp.white_dn_mm2_per_ms[c] = 0.0;
    LitScene one = white;
    one.rig.projectors[0] = lamp;
    one.lit = BuildLitSurface(white.surface, lamp, white.lit.exposure_ms);
    const Image<float> shown = Render(one, map, kWhite);
    float most = 0.0F, off = 0.0F, other = 0.0F;
    for (int j = 0; j < all.height(); ++j)
      for (int i = 0; i < all.width(); ++i) {
        most = std::max(most, all(i, j, colour));
        off = std::max(off, std::abs(shown(i, j, colour) - all(i, j, colour)));
        other = std::max(other, shown(i, j, 1));
      }
    ASSERT_GT(most, 1.0F);
    EXPECT_LT(off, 0.01F * most) << colour;
    EXPECT_EQ(other, 0.0F) << colour;
  }
}

TEST(RenderSubsurface, ShowsEachPatternAsIfItWereAlone) {
  // Colours of unlike strength, the brightest of which the blocks hold; patterns one of which leaves much of the face
  // dark.
  const LitScene scene = MakeScene(FaceLike(), kFromLeft, Cfa::kRggb);
  const MixtureMap map = VaryingSkin(scene, SkinLayers());
  const std::vector<Pattern> patterns = {MiddleLine(scene, 2), kWhite, kSpots};
  std::vector<LitPyramid> lights;
  for (const Pattern& pattern : patterns) lights.push_back(LightWith(scene.lit, pattern));
  const auto together = RenderSubsurface(map, scene.surface, scene.rig, scene.lit, lights);
  ASSERT_EQ(together.size(), patterns.size());
  for (size_t k = 0; k < patterns.size(); ++k) {
    EXPECT_EQ(LargestDifference(together[k], Render(scene, map, patterns[k])), 0.0F) << patterns[k].ToString();
    const Image<float> exact = Reference(scene, map, patterns[k]);
    EXPECT_LT(LargestDifference(together[k], exact), 0.01F * Maximum(exact)) << patterns[k].ToString();
  }
}

TEST(RenderSubsurface, LosesNothingToTheDarkThatItLeavesOut) {
  // A line and a spot light little of the face: only the window that holds their light is looked at. Dark that counts
  // as lit changes no more than the order of the sums.
  const LitScene scene = MakeScene(FaceLike(), kFromLeft, Cfa::kRggb);
  const MixtureMap map = VaryingSkin(scene, {{0.2F, 0.05F, 0.01F}, {0.2F, 0.2F, 0.3F}, {0.2F, 0.6F, 2.5F}});
  for (const Pattern& pattern : {MiddleLine(scene, 2), kSpots, kWhite}) {
    const std::vector<LitPyramid> lights = {LightWith(scene.lit, pattern)};
    std::vector<LitPyramid> everywhere = lights;
    for (LitPlanes& planes : everywhere.front().levels) planes.lit = {0, planes.width - 1, 0, planes.height - 1};
    everywhere.front().shown_lit = {0, lights.front().shown.width() - 1, 0, lights.front().shown.height() - 1};
    const Image<float> with = RenderSubsurface(map, scene.surface, scene.rig, scene.lit, lights).front(),
                       plain = RenderSubsurface(map, scene.surface, scene.rig, scene.lit, everywhere).front();
    ASSERT_GT(Maximum(plain), 1.0F);
    for (size_t i = 0; i < plain.size(); ++i)
      ASSERT_NEAR(with.pixels()[i], plain.pixels()[i], 1e-6F * plain.pixels()[i] + 1e-12F) << pattern.ToString();
  }
}

TEST(RenderSubsurface, ShowsEachColourAtItsOwnSite) {
  // The same skin in every colour: R and B sites lie half a mosaic pixel to either side of the quad's centre, so their
  // pictures of one line differ by one mosaic pixel.
  const LitScene scene = MakeScene(FrontalPlane(), kAtCamera, Cfa::kRggb);
  const MixtureMap map = UniformSkin(scene, {{0.4F, 0.3F, 1.5F}});
  const Image<float> image = Render(scene, map, MiddleLine(scene, 8));
  const double red = CentroidX(scene, image, 0), green = CentroidX(scene, image, 1), blue = CentroidX(scene, image, 2);
  EXPECT_NEAR(red - green, 0.5 * kMosaicPixelMm, 0.02);
  EXPECT_NEAR(green - blue, 0.5 * kMosaicPixelMm, 0.02);
}

TEST(RenderSubsurface, ExchangesNoLightBetweenOppositeFaces) {
  LitScene scene = MakeScene(FrontalPlane(), kAtCamera);
  const MixtureMap map = UniformSkin(scene, SkinLayers());
  for (LitSample& s : scene.lit.samples.pixels()) s.normal = -s.normal;
  EXPECT_EQ(Maximum(Render(scene, map, kWhite)), 0.0F);
  EXPECT_EQ(Maximum(Reference(scene, map, kWhite)), 0.0F);
}

TEST(RenderSubsurface, TakesTheWayThroughARidgeForTheDistance) {
  // A roof of two flanks, a line of light on one of them: what the other shows against what lies as far from the line
  // on the same flank.
  constexpr double kSlope = 0.5, kSigma = 3.0, kLineX = -3.0;
  const HeightField roof = [](double x, double) {
    return Height{kDistanceMm + kSlope * std::abs(x), x < 0.0 ? -kSlope : kSlope, 0.0};
  };
  const LitScene scene = MakeScene(roof, kAtCamera);
  const MixtureMap map = UniformSkin(scene, {{0.3F, 0.0F, static_cast<float>(kSigma)}});
  Pattern line = MiddleLine(scene, 2);
  line.shift += static_cast<int>(std::lround(kLineX / kLightPixelMm));
  // Where the line lies in the middle rows of the light.
  Eigen::Vector3d lit = Eigen::Vector3d::Zero();
  double flux = 0.0;
  const Image<float> shown = LightWith(scene.lit, line).pattern;
  const int row = shown.height() / 2;
  for (int x = 0; x < shown.width(); ++x) {
    const LitSample& s = scene.lit.samples(x, row);
    lit += double{s.flux[0]} * shown(x, row) * s.point_mm.cast<double>();
    flux += double{s.flux[0]} * shown(x, row);
  }
  lit /= flux;
  ASSERT_NEAR(lit.x(), kLineX, 0.5);
  const int j = 18;
  for (const Image<float>& image : {Render(scene, map, line), Reference(scene, map, line)}) {
    const auto nearest = [&](double x) {
      int best = 0;
      for (int i = 0; i < image.width(); ++i)
        if (std::abs(scene.surface.point_mm(i, j, 0) - x) < std::abs(scene.surface.point_mm(best, j, 0) - x)) best = i;
      return best;
    };
    const auto distance2 = [&](int i) {  // across the line
      const Eigen::Vector3d offset = scene.surface.Point(i, j) - lit;
      return offset.x() * offset.x() + offset.z() * offset.z();
    };
    const int other = nearest(3.0), same = nearest(-9.0);
    const double expected = std::exp(-0.5 * (distance2(other) - distance2(same)) / (kSigma * kSigma));
    EXPECT_NEAR(image(other, j) / image(same, j) / expected, 1.0, 0.08);
  }
}

TEST(RenderSubsurface, LeavesUnknownSurfaceAndUnfittedSkinDark) {
  LitScene scene = MakeScene(FrontalPlane(), kAtCamera);
  MixtureMap map = UniformSkin(scene, SkinLayers());
  map.reason[map.ProfileIndex(20, 18, 0)] = static_cast<uint8_t>(FitReason::kTooDark);
  scene.surface.mask(25, 18) = 0;
  for (int k = 0; k < 3; ++k) scene.surface.point_mm(25, 18, k) = std::nanf("");
  const Image<float> image = Render(scene, map, kWhite);
  EXPECT_EQ(image(20, 18), 0.0F);
  EXPECT_EQ(image(25, 18), 0.0F);
  EXPECT_GT(image(22, 18), 100.0F);
  for (float v : image.pixels()) ASSERT_TRUE(std::isfinite(v));
}

TEST(RenderSubsurface, ReadsPooledProfilesAsTheirCopiesOnQuads) {
  const LitScene scene = MakeScene(FaceLike(), kFromLeft);
  MixtureMap fine = VaryingSkin(scene, SkinLayers()), pooled = fine;
  pooled.width = 24;
  pooled.height = 18;
  for (auto* v : {&pooled.weight, &pooled.depth_mm, &pooled.sigma_mm}) v->resize(pooled.profiles() * pooled.layers);
  pooled.reason.resize(pooled.profiles());
  for (int j = 0; j < 36; ++j)
    for (int i = 0; i < 48; ++i)
      for (int l = 0; l < fine.layers; ++l) {
        const int64_t to = fine.ProfileIndex(i, j, 0) * fine.layers + l,
                      from = pooled.ProfileIndex(i / 2, j / 2, 0) * fine.layers + l;
        fine.weight[to] = pooled.weight[from];
        fine.depth_mm[to] = pooled.depth_mm[from];
        fine.sigma_mm[to] = pooled.sigma_mm[from];
      }
  const std::vector<LitPyramid> light = {LightWith(scene.lit, kSpots)};
  const Image<float> a = RenderSubsurface(fine, scene.surface, scene.rig, scene.lit, light).front(),
                     b = RenderSubsurface(pooled, scene.surface, scene.rig, scene.lit, light, {.pool = 2}).front();
  EXPECT_EQ(LargestDifference(a, b), 0.0F);
  EXPECT_GT(Maximum(a), 1.0F);
}

TEST(RenderSubsurface, IsBitIdenticalForAnyNumberOfThreads) {
  const LitScene scene = MakeScene(FaceLike(), kFromLeft);
  const MixtureMap map = VaryingSkin(scene, SkinLayers());
  setenv("STRATALUX_THREADS", "1", 1);
  const Image<float> one = Render(scene, map, kSpots);
  setenv("STRATALUX_THREADS", "3", 1);
  const Image<float> three = Render(scene, map, kSpots);
  unsetenv("STRATALUX_THREADS");
  EXPECT_EQ(LargestDifference(one, three), 0.0F);
}

TEST(ReflectedLight, IsReflectanceTimesIrradianceUnderWhiteLight) {
  const LitScene scene = MakeScene(FaceLike(), {-150.0, 60.0, 50.0});
  Image<float> reflectance(48, 36, 1);
  for (size_t i = 0; i < reflectance.size(); ++i) reflectance.pixels()[i] = 0.01F * static_cast<float>(1 + i % 7);
  const Image<float> image = RenderSurface(scene, reflectance, kWhite);
  const ProjectorCalibration& light = scene.rig.projectors[0];
  for (int j = 4; j < 32; ++j)
    for (int i = 4; i < 44; ++i) {
      const double white = light.WhiteTargetDn(scene.surface.Point(i, j), scene.surface.Normal(i, j), 0, kExposureMs);
      EXPECT_NEAR(image(i, j), reflectance(i, j) * white, 1e-3 * white);
    }
}

TEST(ReflectedLight, KeepsTheLightOfALineAndDoesNotMoveIt) {
  const LitScene scene = MakeScene(FrontalPlane(), kFromLeft);
  const Image<float> reflectance(48, 36, 1, 0.04F);
  const Image<float> image = RenderSurface(scene, reflectance, MiddleLine(scene, 8));
  const LineOnPlane line(scene, 8);
  double sum = 0.0;
  for (int i = 0; i < 48; ++i) sum += image(i, 18) * kMosaicPixelMm;
  const double middle = 0.5 * (line.left_mm + line.right_mm);
  const double white = scene.rig.projectors[0].WhiteTargetDn({middle, 0.0, kDistanceMm}, {0, 0, -1}, 0, kExposureMs);
  EXPECT_NEAR(sum / (0.04 * white * (line.right_mm - line.left_mm)), 1.0, 0.02);
  EXPECT_NEAR(CentroidX(scene, image), middle, 0.03);
}

// A plane's highlight lies where the mirror would show the lamp: lamp at x = -160, eye at x = 0, both at the same
// height above the plane.
TEST(SurfaceReflectance, HighlightFollowsTheLamp) {
  for (const double lamp_x : {-160.0, 120.0}) {
    const LitScene scene = MakeScene(FrontalPlane(), {lamp_x, 0.0, 0.0});
    MixtureMap skin = UniformSkin(scene, SkinLayers());
    skin.scattering.reflection = {1.0, 0.15};
    const Image<float> reflectance = SurfaceReflectance(skin, scene.surface, scene.lit.light, 1);
    EXPECT_GT(reflectance(lamp_x < 0.0 ? 0 : 47, 18), 1.5F * reflectance(lamp_x < 0.0 ? 47 : 0, 18));
    const Eigen::Vector3d point = scene.surface.Point(10, 18);
    const auto angles = ReflectionAngles::Between((Eigen::Vector3d(lamp_x, 0.0, 0.0) - point).normalized(),
                                                  -point.normalized(), scene.surface.Normal(10, 18));
    EXPECT_NEAR(reflectance(10, 18), ReflectanceOf(skin.scattering.reflection, angles, skin.scattering.eta), 1e-6);
  }
}

TEST(SurfaceReflectance, IsTheGlossOfThePlaceThatAProfileComesFrom) {
  const LitScene scene = MakeScene(FrontalPlane(), kFromLeft);
  MixtureMap skin = UniformSkin(scene, SkinLayers());
  skin.scattering.reflection = {1.0, 0.4};
  const Image<float> dry = SurfaceReflectance(skin, scene.surface, scene.lit.light, 1);
  skin.scattering.reflection.by_gloss.fill(1.0);
  skin.scattering.reflection.gloss = {48, 1, 48, 2, {0.0, 1.0, 0.0, 1.0}};  // rises to the right
  const Image<float> glossy = SurfaceReflectance(skin, scene.surface, scene.lit.light, 1);
  for (const int x : {0, 12, 36}) EXPECT_NEAR(glossy(x, 18), (1.0 + x / 48.0) * dry(x, 18), 1e-6);
  // Of a face that moved, each pixel shows another one's skin.
  std::vector<int64_t> from(static_cast<size_t>(skin.profiles()));
  for (size_t i = 0; i < from.size(); ++i) from[i] = skin.ProfileIndex(36, 18, 0);
  const Image<float> carried = SurfaceReflectance(ProfilesOf(skin, from), scene.surface, scene.lit.light, 1);
  EXPECT_NEAR(carried(12, 18), 1.75 * dry(12, 18), 1e-6);
}

TEST(SurfaceReflectance, OfAFitWithoutOneIsTheMeanOfItsLights) {
  const LitScene scene = MakeScene(FrontalPlane(), kFromLeft);
  MixtureMap skin = UniformSkin(scene, SkinLayers());
  skin.training_projectors = {0, 1};
  skin.surface.assign(2 * static_cast<size_t>(skin.profiles()), 0.02F);
  skin.background.assign(skin.surface.size(), 0.0F);
  for (size_t k = 1; k < skin.surface.size(); k += 2) skin.surface[k] = 0.04F;
  EXPECT_NEAR(SurfaceReflectance(skin, scene.surface, scene.lit.light, 1)(20, 20), 0.03F, 1e-7);
  // Of those that lit it.
  for (size_t k = 1; k < skin.surface.size(); k += 2) skin.surface[k] = 0.0F;
  EXPECT_NEAR(SurfaceReflectance(skin, scene.surface, scene.lit.light, 1)(20, 20), 0.02F, 1e-7);
}

}  // namespace
}  // namespace stratalux::fit
