// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/free_fit.h"

#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

constexpr int64_t kProfiles = 32;

SrdBatch Light(double slope, const LayerSet& layers, const EmOptions& options, uint64_t seed) {
  SrdBatch b;
  b.samples = 64;
  b.y.assign(kProfiles * 64, 0.0F);
  b.noise_floor.assign(kProfiles, 0.0F);
  b.noise_slope.assign(kProfiles, static_cast<float>(0.1 / 4000.0));
  b.slope_in.assign(kProfiles, static_cast<float>(slope));
  for (auto* v : {&b.slope_out, &b.slope_in_across, &b.slope_out_across}) v->assign(kProfiles, 0.0F);
  b.cos_in.assign(kProfiles, static_cast<float>(1.0 / std::hypot(1.0, slope)));
  b.cos_out.assign(kProfiles, 1.0F);
  b.step_mm.assign(kProfiles, 0.58F);
  b.line_width_mm.assign(kProfiles, 0.58F);
  b.blur_mm.assign(kProfiles, 0.18F);
  b.valid.assign(kProfiles, 1);
  Random random(seed);
  for (int64_t i = 0; i < kProfiles; ++i) b.first_u_mm.push_back(static_cast<float>(-10.0 + 0.05 * double(i)));
  for (int64_t i = 0; i < kProfiles; ++i) {
    const auto y = PredictSamples(layers, b, i, options.scattering);
    for (int k = 0; k < 64; ++k) {
      const double variance = std::max(y[k], 1e-5) * 0.1 / 4000.0;
      b.y[i * 64 + k] = static_cast<float>(y[k] + random.Normal() * std::sqrt(variance));
    }
  }
  return b;
}

struct Case {
  LayerSet layers{{0.15, 0.2, 0.1}, {0.2, 0.6, 1.2}, {0.4, 1.2, 3.0}};
  EmOptions options = [] {
    EmOptions o;
    o.layers = 6;
    o.surface_term = false;
    o.background_term = false;
    o.max_iterations = 200;
    return o;
  }();
  std::vector<SrdBatch> lights = {Light(-1.0, layers, options, 1), Light(0.6, layers, options, 2),
                                  Light(0.8, layers, options, 3)};
  [[nodiscard]] Result<MixtureMap> Fit() const {
    const std::vector<const SrdBatch*> pointers = {&lights[0], &lights[1], &lights[2]};
    return FitFree(pointers, {0, 1, 2}, kProfiles, 1, 1, options);
  }
};

double HeldOutError(const MixtureMap& map, const Case& c, double slope, double depth_factor) {
  EmOptions tied = c.options;
  const SrdBatch heldout = Light(slope, c.layers, tied, 9);
  double error = 0.0, power = 0.0;
  for (int64_t i = 0; i < kProfiles; ++i) {
    LayerSet layers = LayersOf(map, i);
    for (double& d : layers.depth_mm) d *= depth_factor;
    const auto truth = PredictSamples(c.layers, heldout, i, tied.scattering),
               guess = PredictSamples(layers, heldout, i, tied.scattering);
    for (int k = 0; k < 64; ++k) {
      error += std::pow(guess[k] - truth[k], 2);
      power += truth[k] * truth[k];
    }
  }
  return std::sqrt(error / power);
}

TEST(FitFree, AveragedLayersPredictALightThatNobodyFitted) {
  const Case c;
  const auto map = c.Fit();
  ASSERT_TRUE(map.ok()) << map.status().message();
  double weight = 0.0;
  for (float w : map->weight) weight += w / kProfiles;
  EXPECT_NEAR(weight, 0.45, 0.01);
  const double error = HeldOutError(*map, c, 1.0, 1.0);
  EXPECT_LT(error, 0.05);
  // The depths came from means on either side of the pixel; without them, or the wrong way round, it is worse.
  EXPECT_GT(HeldOutError(*map, c, 1.0, 0.0), 1.5 * error);
  EXPECT_GT(HeldOutError(*map, c, 1.0, -1.0), 3.0 * error);
}

TEST(FitFree, SaysWhatCannotBeKnownAndNeverNan) {
  Case c;
  for (SrdBatch& b : c.lights) b.valid[0] = 0;                                        // lit by nobody
  c.lights[0].valid[1] = c.lights[1].valid[1] = 0;                                    // by one light only
  for (SrdBatch& b : c.lights) b.slope_in[2] = 0.0F;                                  // along the view
  for (SrdBatch& b : c.lights) std::fill_n(b.y.begin() + 3 * 64, 64, std::nanf(""));  // no numbers
  const auto map = c.Fit();
  ASSERT_TRUE(map.ok());
  auto reason = [&](int64_t i) { return static_cast<FitReason>(map->reason[i]); };
  EXPECT_EQ(reason(0), FitReason::kNoProjector);
  EXPECT_EQ(reason(1), FitReason::kFitted);
  EXPECT_EQ(reason(2), FitReason::kDepthNotEstimable);
  EXPECT_EQ(reason(3), FitReason::kNotFinite);
  for (const auto* v :
       {&map->weight, &map->depth_mm, &map->sigma_mm, &map->surface, &map->background, &map->divergence})
    for (float x : *v) ASSERT_TRUE(std::isfinite(x));
  EXPECT_EQ(map->training_projectors.size(), 3U);
  EXPECT_EQ(FitFree({}, {}, 1, 1, 1, c.options).status().code(), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
