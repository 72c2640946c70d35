// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/comb_cycle.h"

#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr int kFrames = 32;

// A cycle over skin that spreads each line over its neighbours, probes evenly passed but for lines 5 and 21, which few
// meet. `shown`: what each frame shows. `noise`: of one reading of a probe, over W - B.
CombCycle Make(const std::vector<int>& shown, double noise, double black_noise, uint64_t seed) {
  Random random(seed);
  CombCycle cycle;
  cycle.frames = kFrames;
  cycle.level.resize(kFrames);
  cycle.variance.resize(kFrames);
  for (int i = 0; i < 1500; ++i) {
    const int line = i % kFrames;
    if ((line == 5 || line == 21) && i > 3 * kFrames) continue;
    cycle.contrast.push_back(100.0F);
    cycle.passed_in.push_back(line);
    cycle.position.push_back(2 * line);
    cycle.x.push_back(i % 40);
    cycle.y.push_back(i / 40);
    cycle.black_variance.push_back(static_cast<float>(black_noise * black_noise));
    const double black = black_noise * random.Normal();
    for (int k = 0; k < kFrames; ++k) {
      const int away = std::min(std::abs(shown[k] - line), kFrames - std::abs(shown[k] - line));
      const double light = away == 0 ? 0.5 : away == 1 ? 0.25 : 0.0;
      cycle.level[k].push_back(static_cast<float>(light + noise * random.Normal() - black));
      cycle.variance[k].push_back(static_cast<float>(noise * noise));
    }
  }
  return cycle;
}

std::vector<int> AsPlanned() {
  std::vector<int> shown(kFrames);
  for (int k = 0; k < kFrames; ++k) shown[k] = k;
  return shown;
}

TEST(MissingComb, IsTheFrameThatShowsAnother) {
  for (const double noise : {0.0, 0.02}) {
    std::vector<int> shown = AsPlanned();
    shown[20] = 11;
    const CombCycle cycle = Make(shown, noise, 0.0, 1);
    const auto missing = FindMissingComb(cycle, FrameGains(cycle));
    ASSERT_TRUE(missing) << noise;
    EXPECT_EQ(missing->frame, 20);
    EXPECT_LT(missing->sum, 0.6);
  }
}

TEST(MissingComb, IsNotFoundInTheNoiseOfLinesThatFewProbesMeet) {
  // Faint light: lines 5 and 21 are off by more than half a frame again and again.
  int off = 0;
  for (uint64_t seed = 1; seed <= 40; ++seed) {
    CombCycle cycle = Make(AsPlanned(), 0.05, 0.02, seed);
    EXPECT_FALSE(FindMissingComb(cycle, FrameGains(cycle))) << seed;
    // The same light as if nothing of it were noise.
    for (auto& variance : cycle.variance) variance.assign(variance.size(), 0.0F);
    cycle.black_variance.assign(cycle.black_variance.size(), 0.0F);
    off += FindMissingComb(cycle, FrameGains(cycle)) ? 1 : 0;
  }
  EXPECT_GT(off, 3);
}

}  // namespace
}  // namespace stratalux::rig
