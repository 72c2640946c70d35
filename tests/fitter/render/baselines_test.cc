// SPDX-License-Identifier: Apache-2.0
#include "fitter/scattering/baselines.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

// Jensen, Marschner, Levoy, Hanrahan 2001, figure 5, red channel: coefficients in 1/mm, the printed diffuse
// reflectance.
struct Material {
  const char* name;
  double sigma_s_prime, sigma_a, reflectance;
};
constexpr Material kMeasured[] = {{"apple", 2.29, 0.003, 0.85},   {"cream", 7.38, 0.0002, 0.98},
                                  {"potato", 0.68, 0.0024, 0.77}, {"skin 1", 0.74, 0.032, 0.44},
                                  {"skin 2", 1.09, 0.013, 0.63},  {"whole milk", 2.55, 0.0011, 0.91}};

TEST(Dipole, ReflectsWhatJensenMeasured) {
  for (const Material& m : kMeasured)
    EXPECT_NEAR((Dipole{m.sigma_s_prime, m.sigma_a, 1.3}.TotalReflectance()), m.reflectance, 0.01) << m.name;
}

TEST(Dipole, IntegratesToItsClosedForm) {
  // Integral of R_d 2 pi r dr over the plane, by r = exp(t).
  for (const Dipole dipole : {Dipole{0.74, 0.032, 1.3}, Dipole{1.01, 0.48, 1.3}, Dipole{1.79, 0.145, 1.4}}) {
    double sum = 0.0;
    const double dt = 0.01;
    for (double t = std::log(1e-4); t < std::log(200.0); t += dt) {
      const double r = std::exp(t);
      sum += dipole.RadialReflectance(r) * 2.0 * std::numbers::pi * r * r * dt;
    }
    EXPECT_NEAR(sum / dipole.TotalReflectance(), 1.0, 2e-3);
  }
}

TEST(Dipole, SpreadsALineWithoutLosingLight) {
  for (const Dipole dipole : {Dipole{0.74, 0.1, 1.4}, Dipole{1.79, 0.145, 1.4}}) {
    double sum = 0.0;
    for (double x = -60.0 + 0.01; x < 60.0; x += 0.02) sum += dipole.LineSpread(x) * 0.02;
    EXPECT_NEAR(sum / dipole.TotalReflectance(), 1.0, 5e-3);
    EXPECT_DOUBLE_EQ(dipole.LineSpread(1.3), dipole.LineSpread(-1.3));
    EXPECT_GT(dipole.LineSpread(0.5), dipole.LineSpread(1.0));
  }
}

TEST(Dipole, SpreadsALineAsTheIntegralOfItsRadialReflectance) {
  // Jensen et al. 2001, equation 4, by a plain midpoint sum along the line.
  for (const Dipole dipole : {Dipole{0.74, 0.1, 1.4}, Dipole{1.79, 0.145, 1.4}})
    for (const double x : {0.0, 0.4, 3.0}) {
      double sum = 0.0;
      for (double y = 0.0005; y < 80.0; y += 0.001) sum += 2.0 * 0.001 * dipole.RadialReflectance(std::hypot(x, y));
      EXPECT_NEAR(dipole.LineSpread(x) / sum, 1.0, 1e-3) << x;
    }
}

// A comb cycle that looks at a dipole, below a surface that sends back the share `surface` where it is hit: box of the
// line and Gaussian blur by quadrature.
SrdBatch CombOver(const Dipole& dipole, int channels, double surface = 0.0) {
  SrdBatch b;
  b.samples = 64;
  constexpr float kStep = 0.58F;
  for (int i = 0; i < channels; ++i) {
    b.first_u_mm.push_back(-32.0F * kStep + 0.07F * static_cast<float>(i));
    b.step_mm.push_back(kStep);
    b.line_width_mm.push_back(kStep);
    b.blur_mm.push_back(0.2F);
    b.noise_floor.push_back(1e-8F);
    b.noise_slope.push_back(0.0F);
    b.valid.push_back(1);
    for (int k = 0; k < b.samples; ++k) {
      const double u = b.first_u_mm.back() + k * double(kStep);
      double y = 0.0, norm = 0.0;
      for (double g = -3.0; g <= 3.0; g += 0.25) {
        const double weight = std::exp(-0.5 * g * g);
        norm += weight;
        for (int s = 0; s < 8; ++s)
          y += weight * dipole.LineSpread(u + 0.2 * g + kStep * ((s + 0.5) / 8 - 0.5)) * kStep / 8;
      }
      double hit = 0.0;
      for (double g = -4.0; g <= 4.0; g += 0.01)
        if (std::abs(u + 0.2 * g) < 0.5 * kStep)
          hit += 0.01 * std::exp(-0.5 * g * g) / std::sqrt(2.0 * std::numbers::pi);
      b.y.push_back(static_cast<float>(y / norm + surface * hit));
    }
  }
  return b;
}

TEST(FitDipole, FindsTheCoefficientsThatMadeTheProfile) {
  const Dipole truth{1.3, 0.06, 1.4};
  const SrdBatch b = CombOver(truth, 1);
  const SrdBatch* light = &b;
  const Dipole found = FitDipole(std::span(&light, 1), 0, 1, 1.4, 0.0);
  EXPECT_NEAR(found.sigma_s_prime_per_mm / truth.sigma_s_prime_per_mm, 1.0, 0.08);
  EXPECT_NEAR(found.sigma_a_per_mm / truth.sigma_a_per_mm, 1.0, 0.10);
  EXPECT_NEAR(found.TotalReflectance() / truth.TotalReflectance(), 1.0, 0.03);
}

// Hair among the skin: a profile apart, dark and without tails.
TEST(FitDipole, IsOfSkinAlone) {
  const Dipole truth{1.3, 0.06, 1.4};
  SrdBatch b = CombOver(truth, 2);
  const SrdBatch hair = CombOver({6.0, 2.0, 1.4}, 2);
  std::copy(hair.y.begin() + hair.samples, hair.y.end(), b.y.begin() + b.samples);
  const SrdBatch* light = &b;
  const double mixed = FitDipole(std::span(&light, 1), 0, 1, 1.4, 0.0).TotalReflectance();
  b.apart = {0, 1};
  const Dipole found = FitDipole(std::span(&light, 1), 0, 1, 1.4, 0.0);
  EXPECT_NEAR(found.sigma_s_prime_per_mm / truth.sigma_s_prime_per_mm, 1.0, 0.08);
  EXPECT_NEAR(found.TotalReflectance() / truth.TotalReflectance(), 1.0, 0.03);
  EXPECT_LT(mixed, 0.9 * truth.TotalReflectance());  // the ablation
}

TEST(FitDipole, TheSurfacesLightIsNoScattering) {
  const Dipole truth{1.3, 0.06, 1.4};
  const SrdBatch b = CombOver(truth, 1, 0.05);
  const SrdBatch* light = &b;
  const Dipole found = FitDipole(std::span(&light, 1), 0, 1, 1.4, 0.05);
  const Dipole with_spike = FitDipole(std::span(&light, 1), 0, 1, 1.4, 0.0);
  EXPECT_NEAR(found.sigma_s_prime_per_mm / truth.sigma_s_prime_per_mm, 1.0, 0.08);
  EXPECT_NEAR(found.TotalReflectance() / truth.TotalReflectance(), 1.0, 0.03);
  EXPECT_GT(with_spike.sigma_s_prime_per_mm, 1.2 * truth.sigma_s_prime_per_mm);  // the ablation
}

MixtureMap TwoColourMap() {
  MixtureMap map;
  map.width = 2;
  map.height = 1;
  map.channels = 2;
  map.layers = 2;
  map.training_projectors = {0};
  // [profile][layer]: pixel 0 colours 0 1, pixel 1 colours 0 1.
  map.weight = {0.1F, 0.3F, 0.2F, 0.2F, 0.3F, 0.5F, 0.4F, 0.0F};
  map.depth_mm = {0.1F, 1.0F, 0.2F, 1.2F, 0.3F, 2.0F, 0.4F, 1.6F};
  map.sigma_mm = {0.3F, 2.0F, 0.4F, 2.4F, 0.5F, 4.0F, 0.6F, 2.6F};
  map.surface.assign(4, 0.0F);
  map.background.assign(4, 0.0F);
  map.reason.assign(4, static_cast<uint8_t>(FitReason::kFitted));
  return map;
}

TEST(Homogeneous, GivesEveryPixelTheMeanOfItsColour) {
  const MixtureMap mean = Homogeneous(TwoColourMap());
  for (int pixel : {0, 1}) {
    EXPECT_FLOAT_EQ(mean.weight[pixel * 4 + 0], 0.2F);
    EXPECT_FLOAT_EQ(mean.weight[pixel * 4 + 1], 0.4F);
    EXPECT_FLOAT_EQ(mean.depth_mm[pixel * 4 + 1], 1.5F);
    EXPECT_FLOAT_EQ(mean.sigma_mm[pixel * 4 + 1], 3.0F);
    EXPECT_FLOAT_EQ(mean.weight[pixel * 4 + 2], 0.3F);  // the other colour
  }
}

TEST(Homogeneous, LeavesUnfittedPixelsOutOfTheMean) {
  MixtureMap map = TwoColourMap();
  map.reason[2] = static_cast<uint8_t>(FitReason::kTooDark);  // pixel 1, colour 0
  EXPECT_FLOAT_EQ(Homogeneous(map).weight[0], 0.1F);
  EXPECT_FALSE(Homogeneous(map).Fitted(2));
}

// Hair is fitted, and has no part in the mean of skin.
TEST(Homogeneous, IsOfSkinAlone) {
  MixtureMap map = TwoColourMap();
  map.surface = {0.02F, 0.0F, 0.3F, 0.0F};
  const std::vector<uint8_t> apart = {0, 0, 1, 1};  // pixel 1, both colours
  const MixtureMap mean = Homogeneous(map, apart);
  for (int pixel : {0, 1}) {
    EXPECT_FLOAT_EQ(mean.weight[pixel * 4 + 0], 0.1F);
    EXPECT_FLOAT_EQ(mean.sigma_mm[pixel * 4 + 1], 2.0F);
    EXPECT_FLOAT_EQ(mean.weight[pixel * 4 + 2], 0.2F);
  }
  const MixtureMap flat = HomogeneousLocalAlbedo(map, apart);
  EXPECT_FLOAT_EQ(flat.weight[5] / flat.weight[4], 3.0F);
  EXPECT_NEAR(flat.weight[4] + flat.weight[5], 0.8F, 1e-6);
  EXPECT_FLOAT_EQ(static_cast<float>(MeanSurfaceReflectance(map, 0, apart)), 0.02F);
  EXPECT_FLOAT_EQ(static_cast<float>(MeanSurfaceReflectance(map, 0)), 0.16F);
}

TEST(HomogeneousLocalAlbedo, KeepsEachPixelsTotalAndSharesTheShape) {
  const MixtureMap map = TwoColourMap(), flat = HomogeneousLocalAlbedo(map);
  for (int i = 0; i < 4; ++i)
    EXPECT_NEAR(flat.weight[2 * i] + flat.weight[2 * i + 1], map.weight[2 * i] + map.weight[2 * i + 1], 1e-6);
  EXPECT_NEAR(flat.weight[1] / flat.weight[0], flat.weight[5] / flat.weight[4], 1e-6);
  EXPECT_FLOAT_EQ(flat.sigma_mm[1], flat.sigma_mm[5]);
}

TEST(DipoleMap, ShowsTheDipolesLineSpreadAndThePixelsOwnAlbedo) {
  MixtureMap map = TwoColourMap();
  map.layers = 12;
  for (auto* v : {&map.weight, &map.depth_mm, &map.sigma_mm}) v->assign(4 * 12, 0.05F);
  const Dipole dipoles[] = {{1.3, 0.06, 1.4}, {1.8, 0.3, 1.4}};
  const auto shown = DipoleMap(map, dipoles);
  ASSERT_TRUE(shown.ok()) << shown.status().message();
  for (int c : {0, 1}) {
    double total = 0.0;
    for (int l = 0; l < 12; ++l) total += shown->weight[c * 12 + l];
    EXPECT_NEAR(total, 0.6, 1e-4);
    for (int l = 0; l < 12; ++l) EXPECT_EQ(shown->depth_mm[c * 12 + l], 0.0F);
    // Same shape as the dipole, both of unit area; error relative to the RMS over +-10 mm, seen through a 0.3 mm line.
    double error = 0.0, power = 0.0;
    for (double x = -10.0; x <= 10.0; x += 0.1) {
      double gaussians = 0.0, dipole = 0.0;
      for (int s = 0; s < 6; ++s) {
        const double u = x + 0.3 * ((s + 0.5) / 6 - 0.5);
        dipole += dipoles[c].LineSpread(u) / dipoles[c].TotalReflectance() / 6;
        for (int l = 0; l < 12; ++l) {
          const double sigma = shown->sigma_mm[c * 12 + l];
          gaussians += shown->weight[c * 12 + l] / 0.6 * std::exp(-0.5 * u * u / (sigma * sigma)) /
                       (sigma * std::sqrt(2.0 * std::numbers::pi)) / 6;
        }
      }
      error += (gaussians - dipole) * (gaussians - dipole);
      power += dipole * dipole;
    }
    EXPECT_LT(std::sqrt(error / power), 0.03) << "colour " << c;
  }
}

}  // namespace
}  // namespace stratalux::fit
