// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/srd_centroid.h"

#include <cmath>

#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

constexpr int kProfiles = 40;

// Light from slopes -0.8 .. 0.8, seen frontally; paper's straight rays, so that s is the slope itself.
SrdBatch Batch() {
  SrdBatch b;
  b.samples = 64;
  for (int i = 0; i < kProfiles; ++i) {
    const float slope = -0.8F + 1.6F * static_cast<float>(i) / (kProfiles - 1);
    b.slope_in.push_back(slope);
    b.cos_in.push_back(1.0F / std::sqrt(1.0F + slope * slope));
    b.first_u_mm.push_back(-10.0F + 0.01F * static_cast<float>(i));
  }
  for (auto* v : {&b.slope_out, &b.slope_in_across, &b.slope_out_across}) v->assign(kProfiles, 0.0F);
  b.cos_out.assign(kProfiles, 1.0F);
  b.step_mm.assign(kProfiles, 0.3F);
  b.line_width_mm.assign(kProfiles, 0.3F);
  b.blur_mm.assign(kProfiles, 0.1F);
  b.valid.assign(kProfiles, 1);
  b.y.assign(kProfiles * 64, 0.0F);
  b.noise_floor.assign(kProfiles, 1e-6F);
  b.noise_slope.assign(kProfiles, 0.0F);
  return b;
}

MixtureMap OneLayer(float depth_mm) {
  MixtureMap map;
  map.width = kProfiles;
  map.height = 1;
  map.channels = 1;
  map.layers = 1;
  map.scattering.shift_law = ShiftLaw::kPaper;
  map.scattering.gain_model = false;
  map.training_projectors = {0};
  map.weight.assign(kProfiles, 0.4F);
  map.depth_mm.assign(kProfiles, depth_mm);
  map.sigma_mm.assign(kProfiles, 0.3F);
  map.surface.assign(kProfiles, 0.0F);
  map.background.assign(kProfiles, 0.0F);
  map.reason.assign(kProfiles, 0);
  return map;
}

SrdBatch LitSkin(const MixtureMap& skin) {
  SrdBatch b = Batch();
  EmOptions options;
  options.scattering.shift_law = ShiftLaw::kPaper;
  options.scattering.gain_model = false;
  for (int i = 0; i < kProfiles; ++i) {
    const auto y = PredictSamples(LayersOf(skin, i), b, i, options.scattering);
    for (int k = 0; k < 64; ++k) b.y[i * 64 + k] = static_cast<float>(y[k]);
  }
  return b;
}

TEST(CompareCentroids, FindsTheDepthOfALayerAndSeesThatABlindFitPredictsNone) {
  const MixtureMap skin = OneLayer(0.5F);
  const SrdBatch heldout = LitSkin(skin);
  const CentroidError own = CompareCentroids(skin, heldout, 1, 3.0, 1),
                      blind = CompareCentroids(OneLayer(0), heldout, 1, 3.0, 1);
  EXPECT_EQ(own.profiles, kProfiles);
  EXPECT_NEAR(own.measured_mm, 0.5, 0.005);  // mm of centroid per mm of depth and unit of s
  EXPECT_NEAR(own.predicted_mm, own.measured_mm, 1e-3);
  EXPECT_LT(own.rms_mm, 1e-3);
  EXPECT_NEAR(blind.measured_mm, own.measured_mm, 1e-9);
  EXPECT_NEAR(blind.predicted_mm, 0.0, 1e-3);
  EXPECT_GT(blind.rms_mm, 0.1);
}

// The surface's own light lies at the line, however obliquely the light enters: the layers' gain is not on it.
TEST(CompareCentroids, OfALightThatWasFittedTheSurfaceIsWhatTheFitFound) {
  MixtureMap skin = OneLayer(0.5F);
  skin.scattering.gain_model = true;
  skin.scattering.tau = 0.3;
  skin.surface.assign(kProfiles, 0.2F);
  SrdBatch light = Batch();
  for (int i = 0; i < kProfiles; ++i) {
    const auto layers = PredictSamples(LayersOf(skin, i), light, i, skin.scattering);
    LayerSet line;  // without width or depth; the model without a gain
    line.weight = {0.2};
    line.depth_mm = {0.0};
    line.sigma_mm = {1e-4};
    const auto surface = PredictSamples(line, light, i, OneLayer(0).scattering);
    for (int k = 0; k < 64; ++k) light.y[i * 64 + k] = static_cast<float>(layers[k] + surface[k]);
  }
  const CentroidError own = CompareCentroids(skin, light, 0, 3.0, 1);
  EXPECT_NEAR(own.predicted_mm, own.measured_mm, 2e-3);
  EXPECT_LT(own.rms_mm, 1e-3);
  // Of another light it is the mean of the lights, which is the same here.
  EXPECT_NEAR(CompareCentroids(skin, light, 1, 3.0, 1).predicted_mm, own.measured_mm, 2e-3);
  skin.surface.assign(kProfiles, 0.0F);
  EXPECT_GT(CompareCentroids(skin, light, 0, 3.0, 1).predicted_mm, 1.2 * own.measured_mm);  // the ablation
}

TEST(CompareCentroids, CountsNothingWhereNothingIsLit) {
  SrdBatch dark = LitSkin(OneLayer(0.5F));
  dark.valid.assign(kProfiles, 0);
  const CentroidError none = CompareCentroids(OneLayer(0.5F), dark, 1, 3.0, 1);
  EXPECT_EQ(none.profiles, 0);
  EXPECT_EQ(none.measured_mm, 0.0);
}

TEST(CompareCentroids, NoiseOfADarkProfileIsNoCentroid) {
  // Samples of both signs that all but cancel: light 20 mm away, by their moment.
  const MixtureMap skin = OneLayer(0.5F);
  SrdBatch heldout = LitSkin(skin);
  for (int k = 0; k < heldout.samples; ++k) heldout.y[static_cast<size_t>(k)] = 0.0F;
  int first = -1;
  for (int k = 0; k < heldout.samples; ++k) {
    const double u = double{heldout.first_u_mm[0]} + k * double{heldout.step_mm[0]};
    if (std::abs(u) < 2.0 && first < 0) first = k;
  }
  heldout.y[static_cast<size_t>(first)] = -1.0F;
  heldout.y[static_cast<size_t>(first) + 5] = 1.05F;
  const CentroidError error = CompareCentroids(skin, heldout, 1, 3.0, 1);
  EXPECT_EQ(error.profiles, kProfiles - 1);
  EXPECT_NEAR(error.measured_mm, 0.5, 0.005);
}

}  // namespace
}  // namespace stratalux::fit
