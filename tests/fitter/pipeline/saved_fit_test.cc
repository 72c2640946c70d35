// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>
#include <unistd.h>

#include "fitter/export/exr_file.h"
#include "fitter/stages/layers_file.h"

namespace stratalux::fit {
namespace {

// 3 x 2 pixels, 3 colours, one layer.
MixtureMap SmallMap() {
  MixtureMap map;
  map.width = 3;
  map.height = 2;
  map.channels = 3;
  map.layers = 1;
  map.training_projectors = {0};
  const auto profiles = static_cast<size_t>(map.profiles());
  for (auto* v : {&map.weight, &map.depth_mm, &map.sigma_mm, &map.surface, &map.background}) v->assign(profiles, 0.5F);
  map.iterations.assign(profiles, 4);
  map.reason.assign(profiles, static_cast<uint8_t>(FitReason::kFitted));
  for (size_t i = 0; i < profiles; ++i) map.divergence.push_back(0.01F * static_cast<float>(i));
  return map;
}

TEST(SavedFit, QualitySaysThePriorsShareAndKeepsWhatOlderReadersNeed) {
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("saved_fit_test_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  MixtureMap map = SmallMap();
  const Image<float> noise(3, 2, 3, 40.0F);
  ASSERT_TRUE(SaveLayers(folder, {map, 1, noise}).ok());
  const std::vector<std::string> shares = {"prior_share.R", "prior_share.G", "prior_share.B"};
  const auto none = ReadExr(folder / "quality.exr", shares);
  ASSERT_TRUE(none.ok()) << none.status().message();
  for (float share : none->pixels()) EXPECT_EQ(share, 0.0F);

  for (int64_t i = 0; i < map.profiles(); ++i) map.prior_share.push_back(0.05F * static_cast<float>(i));
  ASSERT_TRUE(SaveLayers(folder, {map, 1, noise}).ok());
  const auto quality = ReadExr(folder / "quality.exr", shares);
  const auto older = ReadExr(folder / "quality.exr", {"divergence.R", "signal_to_noise.G"});
  ASSERT_TRUE(quality.ok() && older.ok());
  for (int y = 0; y < 2; ++y)
    for (int x = 0; x < 3; ++x) {
      for (int c = 0; c < 3; ++c) EXPECT_EQ((*quality)(x, y, c), map.prior_share[map.ProfileIndex(x, y, c)]);
      EXPECT_EQ((*older)(x, y, 0), map.divergence[map.ProfileIndex(x, y, 0)]);
      EXPECT_EQ((*older)(x, y, 1), 40.0F);
    }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace stratalux::fit
