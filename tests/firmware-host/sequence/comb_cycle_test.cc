// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/comb_cycle.h"

#include <array>
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
    const auto missing = FindMissingComb(cycle);
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
    EXPECT_FALSE(FindMissingComb(cycle)) << seed;
    // The same light as if nothing of it were noise.
    for (auto& variance : cycle.variance) variance.assign(variance.size(), 0.0F);
    cycle.black_variance.assign(cycle.black_variance.size(), 0.0F);
    off += FindMissingComb(cycle) ? 1 : 0;
  }
  EXPECT_GT(off, 3);
}

// Skin of many kinds: what a probe has under the line itself differs by half from probe to probe.
CombCycle Uneven(const std::vector<double>& lamp, uint64_t seed) {
  CombCycle cycle = Make(AsPlanned(), 0.005, 0.0, seed);
  Random random(seed + 1000);
  for (size_t i = 0; i < cycle.passed_in.size(); ++i)
    cycle.level[cycle.passed_in[i]][i] *= static_cast<float>(std::max(0.0, 1.0 + 0.5 * random.Normal()));
  for (int k = 0; k < kFrames; ++k)
    for (float& level : cycle.level[k]) level *= static_cast<float>(lamp[k]);
  return cycle;
}

double DeviationFromOne(const std::vector<double>& values) {
  double squares = 0.0;
  for (const double v : values) squares += std::pow(v - 1.0, 2);
  return std::sqrt(squares / static_cast<double>(values.size()));
}

TEST(FrameGains, AreTheLampsOnSkinOfManyKinds) {
  std::vector<double> lamp(kFrames, 1.0);
  double off = 0.0, plain_off = 0.0;
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    const CombCycle cycle = Uneven(lamp, seed);
    off += DeviationFromOne(FrameGains(cycle));
    // Ablation: the plain sum over the probes that the line passes and their neighbours.
    std::vector<double> plain(kFrames), expected(kFrames);
    for (size_t i = 0; i < cycle.passed_in.size(); ++i)
      for (int k = 0; k < kFrames; ++k) {
        const int away = std::abs(k - cycle.passed_in[i]);
        plain[k] += cycle.level[k][i];
        expected[k] += away == 0 ? 0.5 : away == 1 || away == kFrames - 1 ? 0.25 : 0.0;
      }
    for (int k = 0; k < kFrames; ++k) plain[k] /= expected[k];
    plain_off += DeviationFromOne(plain);
  }
  EXPECT_LT(off, 0.5 * plain_off);
  lamp[13] = 0.8;
  EXPECT_NEAR(FrameGains(Uneven(lamp, 7))[13], 0.8, 0.03);
}

// As a dark face at 696x520: some hundred probes a line, whose shares of white differ by a third under the line and by
// more beside it; and the tip of a nose, where four neighbours, which lie alike in the line, are twenty times as
// bright.
CombCycle Highlit(const std::vector<double>& lamp, uint64_t seed) {
  Random random(seed);
  CombCycle cycle;
  cycle.frames = kFrames;
  cycle.level.resize(kFrames);
  cycle.variance.resize(kFrames);
  std::vector<double> under_tip(kFrames);
  for (double& share : under_tip) share = 0.5 + 0.16 * random.Normal();
  for (int i = 0; i < 95 * kFrames; ++i) {
    const int line = i % kFrames, row = i / kFrames;
    const bool tip = line >= 12 && line < 18 && row < 4;
    cycle.contrast.push_back(tip ? 3000.0F : 150.0F);
    cycle.passed_in.push_back(line);
    const double under = tip ? under_tip[line] : 0.5 + 0.16 * random.Normal();
    for (int k = 0; k < kFrames; ++k) {
      const int away = std::min(std::abs(k - line), kFrames - std::abs(k - line));
      const double share = away == 0 ? under : away == 1 ? 0.17 + 0.1 * random.Normal() : 0.0;
      cycle.level[k].push_back(static_cast<float>(lamp[k] * share + 0.02 * random.Normal()));
    }
  }
  return cycle;
}

TEST(Blinks, AreNotWhatAFewHighlightsOnDarkSkinDo) {
  std::vector<double> steady(kFrames, 1.0), blinking = steady;
  blinking[13] = 0.75;
  int found = 0;
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    EXPECT_TRUE(FindBlinks(FrameGains(Highlit(steady, seed)), 0.15).empty()) << seed;
    const std::vector<Blink> blinks = FindBlinks(FrameGains(Highlit(blinking, seed)), 0.15);
    found += blinks.size() == 1 && blinks[0].frame == 13;
  }
  EXPECT_GE(found, 19);
}

// A highlight of 1,000 on probes of 60 is sixteen times their white.
TEST(Blinks, AreNotTheHighlightThatMovesOntoADimProbe) {
  std::vector<double> steady(kFrames, 1.0), blinking = steady;
  blinking[13] = 0.75;
  int found = 0;
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    const auto lit = [seed](const std::vector<double>& lamp) {
      CombCycle cycle = Highlit(lamp, seed);
      for (const int line : {5, 20}) {  // of its row and line
        cycle.level[line][40 * kFrames + line] = 16.0F;
        cycle.level[(line + 9) % kFrames][60 * kFrames + line] = 16.0F;
      }
      return cycle;
    };
    EXPECT_TRUE(FindBlinks(FrameGains(lit(steady)), 0.15).empty()) << seed;
    const std::vector<Blink> blinks = FindBlinks(FrameGains(lit(blinking)), 0.15);
    found += blinks.size() == 1 && blinks[0].frame == 13;
  }
  EXPECT_GE(found, 19);
}

TEST(Blinks, AreFoundAtAnyPlaceOfTheCycleAndNotInUnevenLight) {
  // As a large camera's combs on a face: a few per cent from frame to frame, two neighbours often to opposite sides.
  int found = 0, false_ones = 0, cycles = 0;
  for (uint64_t seed = 1; seed <= 200; ++seed)
    for (const double deviation : {0.0, 0.02, 0.03}) {
      Random random(seed);
      std::vector<double> gain(64);
      double last = 0.0;
      for (double& g : gain) {
        const double own = random.Normal();
        g = 1.0 + deviation * (own - 0.5 * last);
        last = own;
      }
      false_ones += static_cast<int>(FindBlinks(gain, 0.15).size());
      const int at = std::array{0, 1, 30, 62, 63}[seed % 5];
      gain[at] *= seed % 2 == 0 ? 0.75 : 1.25;
      const std::vector<Blink> blinks = FindBlinks(gain, 0.15);
      found += blinks.size() == 1 && blinks[0].frame == at;
      ++cycles;
    }
  EXPECT_LE(false_ones, 1);
  EXPECT_GT(found, 0.95 * cycles);
}

TEST(Blinks, OfShortCyclesAreAskedOfAllTheirFrames) {
  EXPECT_TRUE(FindBlinks({}, 0.15).empty());
  EXPECT_TRUE(FindBlinks({1.0}, 0.15).empty());
  const std::vector<Blink> blinks = FindBlinks({1.0, 0.6, 1.0, 1.0}, 0.15);
  ASSERT_EQ(blinks.size(), 1U);
  EXPECT_EQ(blinks[0].frame, 1);
  EXPECT_NEAR(blinks[0].light, 0.6, 1e-12);
}

// What eight combs of a small projector gave, and gave with a blink in one of them: a frame's own deviation, half a
// rank of so few, had raised the limit over itself.
TEST(Blinks, OfFewFramesAreJudgedByTheOthers) {
  EXPECT_TRUE(FindBlinks({0.986, 1.003, 0.983, 0.955, 0.995, 1.027, 1.024, 0.981}, 0.15).empty());
  const std::vector<Blink> blinks = FindBlinks({1.006, 0.823, 1.015, 0.965, 1.004, 1.058, 1.034, 0.990}, 0.15);
  ASSERT_EQ(blinks.size(), 1U);
  EXPECT_EQ(blinks[0].frame, 1);
}

// What a person's face at full size gave (frames of one projector): its second frame was taken for a blink, since only
// the four frames about it were asked, and the larger of their two middles.
TEST(Blinks, AreNotTheUnevenBeginOfACycle) {
  const std::vector<double> gain{1.085, 0.912, 0.999, 1.089, 0.974, 0.944, 1.046, 0.993, 0.929, 1.005, 1.027, 1.048,
                                 1.009, 0.999, 0.981, 0.949, 0.970, 1.079, 1.005, 0.989, 1.016, 0.938, 1.010, 1.084};
  EXPECT_TRUE(FindBlinks(gain, 0.15).empty());
}

}  // namespace
}  // namespace stratalux::rig
