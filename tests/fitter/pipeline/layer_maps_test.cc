// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/layer_maps.h"

#include <array>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/export/exr_file.h"
#include "fitter/export/pictures.h"
#include "fitter/report/html_report.h"
#include "fitter/report/layer_pictures.h"
#include "shared/base/random.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

// 6 x 4 pixels, 3 colours, two layers; depths and widths rise with x.
MixtureMap SmallMap() {
  MixtureMap map;
  map.width = 6;
  map.height = 4;
  map.channels = 3;
  map.layers = 2;
  map.training_projectors = {0, 1};
  for (int64_t i = 0; i < map.profiles(); ++i) {
    const auto x = static_cast<float>(i / 3 % 6);
    map.weight.insert(map.weight.end(), {0.3F, 0.1F});
    map.depth_mm.insert(map.depth_mm.end(), {0.1F * x, 0.1F * x + 1.0F});
    map.sigma_mm.insert(map.sigma_mm.end(), {1.0F + 0.1F * x, 3.0F});
  }
  const size_t profiles = static_cast<size_t>(map.profiles());
  map.surface.assign(2 * profiles, 0.0F);
  map.background.assign(2 * profiles, 0.0F);
  map.divergence.assign(profiles, 0.01F);
  map.iterations.assign(profiles, 4);
  map.reason.assign(profiles, static_cast<uint8_t>(FitReason::kFitted));
  map.reason[0] = static_cast<uint8_t>(FitReason::kTooDark);
  map.reason[4] = static_cast<uint8_t>(FitReason::kDepthNotEstimable);
  return map;
}

TEST(LayerMaps, SumUpEachPixelsLayers) {
  const MixtureMap map = SmallMap();
  const LayerMaps maps = SummariseLayers(map);
  EXPECT_TRUE(std::isnan(maps.total_weight(0, 0, 0)));  // too dark
  EXPECT_NEAR(maps.total_weight(3, 2, 1), 0.4, 1e-6);
  EXPECT_NEAR(maps.absorption(3, 2, 1), 0.6, 1e-6);
  EXPECT_NEAR(maps.mean_depth_mm(3, 2, 1), 0.3 + 0.25, 1e-6);
  EXPECT_NEAR(maps.effective_width_mm(3, 2, 1), std::sqrt((0.3 * 1.69 + 0.1 * 9.0) / 0.4), 1e-6);
  // Light along the view tells nothing of depth, but of weight and width.
  EXPECT_TRUE(std::isnan(maps.mean_depth_mm(1, 0, 1)));
  EXPECT_NEAR(maps.total_weight(1, 0, 1), 0.4, 1e-6);
}

TEST(LayerMaps, BandsHoldAThirdOfTheLightEachAndAddUpToTheTotal) {
  const MixtureMap map = SmallMap();
  const LayerMaps maps = SummariseLayers(map);
  double band[3] = {}, total = 0.0;
  for (size_t i = 0; i < maps.shallow.size(); ++i) {
    if (std::isnan(maps.shallow.pixels()[i])) continue;
    EXPECT_NEAR(maps.shallow.pixels()[i] + maps.middle.pixels()[i] + maps.deep.pixels()[i],
                maps.total_weight.pixels()[i], 1e-6);
    band[0] += maps.shallow.pixels()[i];
    band[1] += maps.middle.pixels()[i];
    band[2] += maps.deep.pixels()[i];
    total += maps.total_weight.pixels()[i];
  }
  for (double b : band) EXPECT_NEAR(b / total, 1.0 / 3.0, 0.13);  // layers of equal width cannot be parted
  EXPECT_LT(maps.bands.shallow_mm, maps.bands.deep_mm);
}

TEST(LayerMaps, AreWrittenAsExrAndShownWithColourBars) {
  const MixtureMap map = SmallMap();
  const LayerMaps maps = SummariseLayers(map);
  const ScratchFolder folder;
  ASSERT_TRUE(WriteLayerMaps(folder.path(), maps).ok());
  const auto depth = ReadExr(folder / "mean_depth_mm.exr", {"R", "G", "B"});
  ASSERT_TRUE(depth.ok());
  EXPECT_EQ((*depth)(3, 2, 1), maps.mean_depth_mm(3, 2, 1));
  const auto bands = ReadExr(folder / "depth_bands.exr", {"shallow.B", "middle.B", "deep.B"});
  ASSERT_TRUE(bands.ok());
  EXPECT_EQ((*bands)(5, 1, 2), maps.deep(5, 1, 2));
  const ReportSection section = LayerPictures(ShownOf({map, 1, Image<float>(6, 4, 3, 80.0F)}, 4));
  EXPECT_GE(section.images.size(), 9U);
  const auto html = RenderHtml({"t", "s", {section}});
  ASSERT_TRUE(html.ok());
  EXPECT_NE(html->find("class='bar'"), std::string::npos);
  EXPECT_EQ(html->find("%SCALE%"), std::string::npos);
  EXPECT_EQ(html->find("nan"), std::string::npos);
}

// Four lights, each of which is off by a share of its own at each pixel (of depths by mm), and the fits that leave one
// of them out.
struct Disagreeing {
  static constexpr int kSize = 60, kLights = 4;
  static constexpr float kTrue = 0.4F;
  std::vector<EffectiveMaps> left_out;
  EffectiveMaps noise;

  // `off`: standard deviation of a light, left half; three times as much on the right.
  explicit Disagreeing(double off) {
    const Image<float> map(kSize, kSize, 3);
    left_out.assign(kLights, {map, map, map});
    noise = {map, map, map};
    Random random(11);
    for (const auto quantity :
         {&EffectiveMaps::total_weight, &EffectiveMaps::mean_depth_mm, &EffectiveMaps::effective_width_mm})
      for (size_t i = 0; i < map.size(); ++i) {
        const bool right = i / 3 % kSize >= kSize / 2;
        std::array<double, kLights> light{};
        for (double& l : light) l = off * (right ? 3.0 : 1.0) * random.Normal();
        for (size_t p = 0; p < kLights; ++p) {
          double mean = 0.0;
          for (size_t k = 0; k < kLights; ++k) mean += k == p ? 0.0 : light[k] / (kLights - 1);
          const bool relative = quantity != &EffectiveMaps::mean_depth_mm;
          (left_out[p].*quantity).pixels()[i] = static_cast<float>(kTrue + mean * (relative ? kTrue : 1.0));
        }
        (noise.*quantity).pixels()[i] = 1e-4F;
      }
  }
};

TEST(WithDisagreement, IntervalsHoldTheTruthOfLightsThatErrEachForItself) {
  const Disagreeing lights(0.05);
  const EffectiveMaps& fit = lights.left_out[3];
  const EffectiveMaps errors = WithDisagreement(lights.noise, fit, lights.left_out, 5);
  for (const auto quantity :
       {&EffectiveMaps::total_weight, &EffectiveMaps::mean_depth_mm, &EffectiveMaps::effective_width_mm})
    for (const int from : {0, Disagreeing::kSize / 2 + 6}) {  // away from where the error changes
      int64_t inside = 0, all = 0;
      for (int y = 0; y < Disagreeing::kSize; ++y)
        for (int x = from; x < from + Disagreeing::kSize / 2 - 6; ++x)
          for (int c = 0; c < 3; ++c, ++all)
            inside += std::abs((fit.*quantity)(x, y, c) - Disagreeing::kTrue) <= 1.96 * (errors.*quantity)(x, y, c);
      EXPECT_NEAR(static_cast<double>(inside) / static_cast<double>(all), 0.95, 0.02) << from;
    }
}

TEST(WithDisagreement, IsNeverBelowTheNoiseAndTellsNothingOfWhatIsUnknown) {
  Disagreeing lights(0.001);
  lights.noise.total_weight(10, 10, 1) = 0.2F;
  lights.noise.total_weight(11, 10, 1) = std::nanf("");
  lights.left_out[2].total_weight(12, 10, 1) = std::nanf("");
  for (int y = 0; y < 6; ++y)
    for (int x = 0; x < 6; ++x) lights.left_out[0].mean_depth_mm(x, y, 2) = std::nanf("");
  const EffectiveMaps errors = WithDisagreement(lights.noise, lights.left_out[3], lights.left_out, 2);
  EXPECT_NEAR(errors.total_weight(10, 10, 1), 0.2, 1e-4);
  EXPECT_TRUE(std::isnan(errors.total_weight(11, 10, 1)));
  EXPECT_GT(errors.total_weight(12, 10, 1), 1.3e-4);  // as its neighbours, 0.001 x 0.4 / sqrt(3) and its noise
  EXPECT_LT(errors.total_weight(12, 10, 1), 5e-4);
  EXPECT_EQ(errors.mean_depth_mm(1, 1, 2), 1e-4F);  // nobody around is known: its noise
  EXPECT_GT(errors.mean_depth_mm(20, 20, 2), 2e-4F);
}

}  // namespace
}  // namespace stratalux::fit
