// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/directional_weights.h"

#include <cmath>

#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

constexpr double kDegree = 3.14159265358979 / 180.0;
constexpr DirectionalWeights kSkin = {1.5, 1.1, 0.1};

// A profile in the plane of incidence: angles outside the skin towards the same side.
RefractedDirections Directions(double in_deg, double out_deg) {
  SrdBatch b;
  b.slope_in = {static_cast<float>(std::tan(in_deg * kDegree))};
  b.slope_out = {static_cast<float>(std::tan(out_deg * kDegree))};
  b.slope_in_across = b.slope_out_across = {0.0F};
  return DirectionsOf(b, 0, 1.4);
}

TEST(DirectionalWeights, FollowSnellInsideTheSkin) {
  const double in = std::asin(std::sin(45.0 * kDegree) / 1.4), out = std::asin(std::sin(30.0 * kDegree) / 1.4);
  const RefractedDirections same = Directions(45, 30), opposite = Directions(45, -30);
  EXPECT_NEAR(same.sec_in, 1.0 / std::cos(in), 1e-6);
  EXPECT_NEAR(same.sec_out, 1.0 / std::cos(out), 1e-6);
  EXPECT_NEAR(same.cos_scatter, -std::cos(in - out), 1e-6);
  EXPECT_NEAR(opposite.cos_scatter, -std::cos(in + out), 1e-6);
  EXPECT_NEAR(Directions(30, 30).cos_scatter, -1.0, 1e-6);  // straight back to the lamp
}

TEST(DirectionalWeights, AreOneFrontallyAndWhenOff) {
  for (double sigma : {0.01, 0.1, 3.0}) {
    EXPECT_NEAR(DirectionalFactor(kSkin, Directions(0, 0), 0.5, sigma), 1.0, 1e-6);
    EXPECT_EQ(DirectionalFactor({}, Directions(60, -40), 0.5, sigma), 1.0);
  }
}

TEST(DirectionalWeights, AreReciprocal) {
  for (double sigma : {0.02, 0.3})
    EXPECT_NEAR(DirectionalFactor(kSkin, Directions(50, -20), 0.3, sigma),
                DirectionalFactor(kSkin, Directions(-20, 50), 0.3, sigma), 1e-6);
}

TEST(DirectionalWeights, ThinSheetReturnsItsSingleScatteringIntegral) {
  // A sheet of isotropic scatterers at depth z under attenuation mu: sec_i sec_o exp(-mu z (sec_i + sec_o)), here over
  // its frontal value.
  const double in = std::asin(std::sin(60.0 * kDegree) / 1.4), mu = 2.0, z = 0.2;
  const double expected = 1.0 / std::cos(in) * std::exp(-mu * z * (1.0 / std::cos(in) - 1.0));
  EXPECT_NEAR(DirectionalFactor({mu, 0.0, 1e6}, Directions(60, 0), z, 0.01), expected, 1e-5);
}

TEST(DirectionalWeights, WideLayersForgetThePhaseFunction) {
  const RefractedDirections oblique = Directions(60, -40);
  EXPECT_GT(DirectionalFactor({0.0, 1.1, 0.1}, oblique, 0.3, 0.02), 1.5);
  EXPECT_NEAR(DirectionalFactor({0.0, 1.1, 0.1}, oblique, 0.3, 2.0), 1.0, 1e-6);
}

}  // namespace
}  // namespace stratalux::fit
