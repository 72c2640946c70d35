// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/exposure_choice.h"

#include <cmath>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr double kScanMs = 16.0;

// A square before darkness: its light falls from the middle outwards to `edge` of the middle's; the sites of the mosaic
// have their own albedo.
struct Subject {
  double middle_dn = 1000.0;  // white minus black at kScanMs, of an albedo of 1
  double edge = 0.3;
  double albedo[4] = {1.0, 0.7, 0.7, 0.4};
};

struct Frames {
  Image<uint16_t> white, black;
};

class ExposureChoiceTest : public ::testing::Test {
 protected:
  static constexpr int kWidth = 160, kHeight = 128;
  [[nodiscard]] double SignalDn(const Subject& s, int x, int y) const {
    // As wide and high as whole blocks, so that none is half dark.
    if (std::abs(x - 79.5) > 48.0 || std::abs(y - 63.5) > 48.0) return 0.0;
    const double r = std::max(std::abs(x - 79.5), std::abs(y - 63.5)) / 48.0;
    return s.middle_dn * (1.0 - (1.0 - s.edge) * r) * s.albedo[2 * (y & 1) + (x & 1)];
  }
  [[nodiscard]] uint16_t Sample(double light_dn) {
    const double electrons = std::poisson_distribution<int>(std::max(1e-9, light_dn * rule_.gain_e_per_dn))(random_);
    const double read = std::normal_distribution<>(0.0, rule_.read_noise_dn)(random_);
    return static_cast<uint16_t>(
        std::clamp(rule_.black_level_dn + electrons / rule_.gain_e_per_dn + read + 0.5, 0.0, 4095.0));
  }
  Frames Scan(const Subject& subject, double ms = kScanMs) {
    Frames frames{Image<uint16_t>(kWidth, kHeight), Image<uint16_t>(kWidth, kHeight)};
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        frames.white(x, y) = Sample(SignalDn(subject, x, y) * ms / kScanMs);
        frames.black(x, y) = Sample(0.0);
      }
    return frames;
  }
  // Measured, not foreseen: mean over deviation of repeated differences, of the darkest tenth of the quads that have a
  // tenth and more of the brightest tenth's light.
  double MeasuredSnr(const Subject& subject, double ms) {
    std::vector<std::pair<double, std::pair<int, int>>> quads;
    for (int y = 0; y < kHeight; y += 2)
      for (int x = 0; x < kWidth; x += 2)
        if (const double signal = SignalDn(subject, x, y); signal > 0.0) quads.push_back({signal, {x, y}});
    std::sort(quads.begin(), quads.end());
    const auto [x, y] = quads[quads.size() / 10].second;
    double sum = 0.0, squares = 0.0;
    constexpr int kTries = 4000;
    for (int i = 0; i < kTries; ++i) {
      double difference = 0.0;
      for (int site = 0; site < 4; ++site)
        difference +=
            double(Sample(SignalDn(subject, x + site % 2, y + site / 2) * ms / kScanMs)) - double(Sample(0.0));
      sum += difference;
      squares += difference * difference;
    }
    const double mean = sum / kTries;
    return mean / std::sqrt(squares / kTries - mean * mean);
  }

  ExposureRule rule_{.black_level_dn = 64.0};
  std::mt19937_64 random_{7};
};

TEST_F(ExposureChoiceTest, TheDarkestTenthReachesTheRatioOnEverySkin) {
  for (const double middle : {20.0, 60.0, 250.0, 1000.0}) {
    const Subject subject{.middle_dn = middle};
    rule_.longest_ms = 1000.0;
    rule_.nominal_ms = 0.0;
    rule_.max_saturated = 0.5;
    const Frames scan = Scan(subject);
    const auto choice = ChooseExposure({{scan.white, scan.black}}, kScanMs, rule_);
    ASSERT_TRUE(choice.ok()) << choice.status().message();
    EXPECT_NEAR(MeasuredSnr(subject, choice->exposure_ms), rule_.wanted_snr, 0.06 * rule_.wanted_snr) << middle;
    EXPECT_NEAR(choice->snr, rule_.wanted_snr, 0.01);
    EXPECT_THAT(choice->findings, IsEmpty());
  }
}

TEST_F(ExposureChoiceTest, TheDimmestProjectorDecidesAndTheBrightestLimits) {
  const Subject dim{.middle_dn = 100.0}, bright{.middle_dn = 1200.0};
  const Frames a = Scan(bright), b = Scan(dim);
  const auto both = ChooseExposure({{a.white, a.black}, {b.white, b.black}}, kScanMs, rule_);
  const auto alone = ChooseExposure({{b.white, b.black}}, kScanMs, rule_);
  ASSERT_TRUE(both.ok() && alone.ok());
  EXPECT_DOUBLE_EQ(both->exposure_ms, alone->exposure_ms);
  rule_.wanted_snr = 40.0;
  const Frames c = Scan({.middle_dn = 3900.0});
  const auto limited = ChooseExposure({{c.white, c.black}, {b.white, b.black}}, kScanMs, rule_);
  ASSERT_TRUE(limited.ok());
  EXPECT_LE(limited->saturated, 1.05 * rule_.max_saturated);
  EXPECT_LT(limited->exposure_ms, 1.2 * kScanMs);
  ASSERT_FALSE(limited->findings.empty());
  EXPECT_EQ(limited->findings[0].kind, FindingKind::kDim);
  EXPECT_EQ(limited->findings[0].projector, 1);
  EXPECT_DOUBLE_EQ(limited->findings[0].value, limited->snr);
}

TEST_F(ExposureChoiceTest, SaturationIsThatOfTheFrameThatIsTaken) {
  const Subject subject{.middle_dn = 1500.0, .edge = 0.02};
  rule_.wanted_snr = 200.0;
  const Frames scan = Scan(subject);
  const auto choice = ChooseExposure({{scan.white, scan.black}}, kScanMs, rule_);
  ASSERT_TRUE(choice.ok());
  const Frames taken = Scan(subject, choice->exposure_ms);
  double lit = 0.0, saturated = 0.0;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      if (SignalDn(subject, x, y) <= 0.0) continue;
      lit += 1.0;
      saturated += taken.white(x, y) >= rule_.saturation_dn;
    }
  EXPECT_GT(saturated / lit, 0.5 * rule_.max_saturated);
  EXPECT_LT(saturated / lit, 1.5 * rule_.max_saturated);
}

TEST_F(ExposureChoiceTest, TheRoomsLightSaturatesToo) {
  const Subject subject{.middle_dn = 1500.0, .edge = 0.02};
  Frames scan = Scan(subject);
  for (Image<uint16_t>* image : {&scan.white, &scan.black})
    for (uint16_t& value : image->pixels()) value = static_cast<uint16_t>(value + 800);
  rule_.wanted_snr = 400.0;
  const auto choice = ChooseExposure({{scan.white, scan.black}}, kScanMs, rule_);
  ASSERT_TRUE(choice.ok());
  const Frames taken = Scan(subject, choice->exposure_ms);
  const double room_dn = 800.0 * choice->exposure_ms / kScanMs;
  double lit = 0.0, saturated = 0.0;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      if (SignalDn(subject, x, y) <= 0.0) continue;
      lit += 1.0;
      saturated += taken.white(x, y) + room_dn >= rule_.saturation_dn;
    }
  EXPECT_GT(saturated / lit, 0.2 * rule_.max_saturated);
  EXPECT_LT(saturated / lit, 1.5 * rule_.max_saturated);
}

TEST_F(ExposureChoiceTest, AProjectorThatLightsNothingIsTold) {
  const Frames good = Scan({.middle_dn = 1000.0}), dead = Scan({.middle_dn = 0.0});
  const auto choice = ChooseExposure({{good.white, good.black}, {dead.white, dead.black}}, kScanMs, rule_);
  ASSERT_TRUE(choice.ok());
  EXPECT_THAT(choice->findings, ElementsAre(Finding{FindingKind::kDim, 1, -1, 0.0, rule_.wanted_snr}));
}

TEST_F(ExposureChoiceTest, BrightSkinKeepsTheNominalExposureUnlessItSaturates) {
  const Frames bright = Scan({.middle_dn = 3000.0});
  const auto kept = ChooseExposure({{bright.white, bright.black}}, kScanMs, rule_);
  ASSERT_TRUE(kept.ok());
  EXPECT_DOUBLE_EQ(kept->exposure_ms, rule_.nominal_ms);
  rule_.nominal_ms = 32.0;
  const auto shorter = ChooseExposure({{bright.white, bright.black}}, kScanMs, rule_);
  ASSERT_TRUE(shorter.ok());
  EXPECT_LT(shorter->exposure_ms, 32.0);
  EXPECT_GT(shorter->exposure_ms, kScanMs);
}

TEST_F(ExposureChoiceTest, WhatTheBoundsForbidIsAFinding) {
  rule_.longest_ms = 20.0;
  const Frames scan = Scan({.middle_dn = 10.0});
  const auto choice = ChooseExposure({{scan.white, scan.black}}, kScanMs, rule_);
  ASSERT_TRUE(choice.ok());
  EXPECT_DOUBLE_EQ(choice->exposure_ms, 20.0);
  EXPECT_THAT(choice->findings, ElementsAre(Finding{FindingKind::kDim, 0, -1, choice->snr, rule_.wanted_snr}));
}

TEST_F(ExposureChoiceTest, AScanThatSaturatesIsToldAndAnEmptyBoxFails) {
  const Frames bright = Scan({.middle_dn = 9000.0});
  const auto choice = ChooseExposure({{bright.white, bright.black}}, kScanMs, rule_);
  ASSERT_TRUE(choice.ok());
  EXPECT_TRUE(choice->prescan_saturated);
  const Frames empty = Scan({.middle_dn = 0.0});
  EXPECT_EQ(ChooseExposure({{empty.white, empty.black}}, kScanMs, rule_).status().code(), StatusCode::kFailed);
}

TEST_F(ExposureChoiceTest, TheLongestExposureFillsTheVisit) {
  PlanOptions plan;
  VisitTiming timing;
  plan.exposure_ms = LongestExposureMs(plan, timing, std::chrono::seconds(20)).value();
  const double seconds = 1e-9 * static_cast<double>(VisitTime(*BuildPlan(plan), timing).count());
  EXPECT_LE(seconds, 20.0);
  EXPECT_GT(seconds, 19.9);
  plan.exposure_ms = 16.0;
  EXPECT_DOUBLE_EQ(LongestExposureMs(plan, timing, std::chrono::seconds(1)).value(), 0.0)
      << "settling alone takes more";
  plan.comb_width = 0;
  EXPECT_EQ(LongestExposureMs(plan, timing, std::chrono::seconds(20)).status().code(), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::rig
