// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/gray_decoder.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "tests/fitter/geometry/synthetic_rig.h"

namespace stratalux::fit {
namespace {

class GrayDecoder : public testing::Test {
 protected:
  [[nodiscard]] DecodeReport Decode(const Frames& frames, int period_px = kPeriodPx) const {
    auto report = DecodeGray(frames.Decode(rig_.projectors[0], period_px), SensorNoise::From(rig_.camera));
    EXPECT_TRUE(report.ok()) << report.status().message();
    return std::move(report).value();
  }
  static double Largest(const DecodedMap& map, const Frames& frames) {
    double largest = 0.0;
    for (size_t s = 0; s < map.reason.size(); ++s)
      if (map.reason.data()[s] == 0)
        largest = std::max({largest, std::abs(map.column.data()[s] - frames.true_column.data()[s]),
                            std::abs(map.row.data()[s] - frames.true_row.data()[s])});
    return largest;
  }
  // Sites that the white frame shows at least 10 % as bright as a facing one: grazing light decodes by luck.
  static double Lit(const Frames& frames) {
    const RawView white = frames.View({.kind = PatternKind::kWhite});
    const uint16_t brightest = *std::max_element(white.pixels().begin(), white.pixels().end());
    double lit = 0.0;
    for (size_t s = 0; s < white.size(); ++s)
      lit += white.data()[s] - frames.black.data()[s] > 0.1 * (brightest - frames.black.data()[s]) ? 1.0 : 0.0;
    return lit;
  }
  RigCalibration rig_ = SyntheticRig();
};

TEST_F(GrayDecoder, FindsEveryLitSiteWithoutNoise) {
  const Frames frames = Shoot(rig_, 0, kBall, {});
  const DecodeReport report = Decode(frames);
  EXPECT_GT(static_cast<double>(report.counts[0]), 0.98 * Lit(frames));
  EXPECT_LT(Largest(report.map, frames), 0.05);  // rounding to whole digital numbers
}

TEST_F(GrayDecoder, GivesTheColumnWithoutSinusoids) {
  const Frames frames = Shoot(rig_, 0, kBall, {.blur_px = 0.3});
  const DecodeReport report = Decode(frames, 0);
  EXPECT_GT(static_cast<double>(report.counts[0]), 0.98 * Lit(frames));
  EXPECT_LT(Largest(report.map, frames), 0.8);  // at the rim, where the ball falls away from the neighbours' plane
}

constexpr ColumnCode kCodes[] = {ColumnCode::kGray, ColumnCode::kXor2, ColumnCode::kXor4, ColumnCode::kMinStripe,
                                 ColumnCode::kMicroPhase};

TEST_F(GrayDecoder, ReadsEachCodeWithSinusoids) {
  for (const ColumnCode code : kCodes) {
    const Frames frames = Shoot(rig_, 0, kBall, {.code = code});
    const DecodeReport report = Decode(frames);
    // On an edge of the base all planes are doubtful at once, in columns or in rows.
    const double least = code == ColumnCode::kXor2 ? 0.7 : code == ColumnCode::kXor4 ? 0.85 : 0.98;
    EXPECT_GT(static_cast<double>(report.counts[0]), least * Lit(frames)) << ToString(code);
    EXPECT_LT(Largest(report.map, frames), 0.05) << ToString(code);
  }
}

TEST_F(GrayDecoder, ReadsEachCodeByItself) {
  for (const ColumnCode code : kCodes) {
    const Frames frames = Shoot(rig_, 0, kBall, {.blur_px = 0.3, .code = code});
    const DecodeReport report = Decode(frames, 0);
    EXPECT_GT(static_cast<double>(report.counts[0]), 0.97 * Lit(frames)) << ToString(code);
    EXPECT_LT(Largest(report.map, frames), 0.8) << ToString(code);
  }
}

TEST_F(GrayDecoder, PlacesNoSiteElsewhereForNoiseWhateverTheCode) {
  for (const ColumnCode code : kCodes)
    for (const int period : {kPeriodPx, 0}) {
      const Frames frames = Shoot(rig_, 0, kBall, {.albedo = 0.2, .noise = true, .code = code});
      const DecodeReport report = Decode(frames, period);
      int64_t gross = 0;
      for (size_t s = 0; s < report.map.reason.size(); ++s)
        if (report.map.reason.data()[s] == 0)
          gross += std::abs(report.map.column.data()[s] - frames.true_column.data()[s]) > 4.0 ? 1 : 0;
      std::printf("%s, %s: %.3f of lit sites kept\n", ToString(code), period > 0 ? "with sinusoids" : "bits alone",
                  static_cast<double>(report.counts[0]) / Lit(frames));
      EXPECT_GT(static_cast<double>(report.counts[0]), 0.45 * Lit(frames)) << ToString(code);
      EXPECT_EQ(gross, 0) << ToString(code) << ", period " << period;
    }
}

TEST_F(GrayDecoder, IsInvariantToAmbientLightAndAlbedo) {
  const Frames dim = Shoot(rig_, 0, kBall, {.albedo = 0.3, .ambient_dn = 10.0});
  const Frames bright = Shoot(rig_, 0, kBall, {.albedo = 0.8, .ambient_dn = 300.0});
  const DecodeReport a = Decode(dim), b = Decode(bright);
  double both = 0.0;
  for (size_t s = 0; s < a.map.reason.size(); ++s) {
    if (a.map.reason.data()[s] != 0 || b.map.reason.data()[s] != 0) continue;
    ++both;
    ASSERT_NEAR(a.map.column.data()[s], b.map.column.data()[s], 0.08);
  }
  EXPECT_GT(both, 0.95 * Lit(dim));
}

TEST_F(GrayDecoder, PredictsItsOwnNoise) {
  const Frames frames = Shoot(rig_, 0, kBall, {.albedo = 0.2, .noise = true});
  const DecodeReport report = Decode(frames);
  double sum = 0.0;
  int64_t count = 0;
  for (size_t s = 0; s < report.map.reason.size(); ++s) {
    if (report.map.reason.data()[s] != 0) continue;
    const double z = (report.map.column.data()[s] - frames.true_column.data()[s]) / report.map.column_sigma.data()[s];
    ASSERT_LT(std::abs(z), 8.0) << "a wrong period at site " << s;
    sum += z * z;
    ++count;
  }
  ASSERT_GT(count, 2000);
  EXPECT_NEAR(sum / static_cast<double>(count), 1.0, 0.1);
}

TEST_F(GrayDecoder, SurvivesStrongGlobalLight) {
  const Frames frames = Shoot(rig_, 0, kBall, {.global = 2.0, .noise = true});
  const DecodeReport report = Decode(frames);
  EXPECT_GT(static_cast<double>(report.counts[0]), 0.95 * Lit(frames));
  EXPECT_LT(Largest(report.map, frames), 1.0);  // never a wrong period
}

TEST_F(GrayDecoder, NamesUnlitAndSaturatedSites) {
  const DecodeReport dark = Decode(Shoot(rig_, 0, kBall, {.white_dn = 3.0}));
  EXPECT_EQ(dark.counts[static_cast<int>(DecodeReason::kUnlit)], static_cast<int64_t>(dark.map.reason.size()));
  // Global light alone saturates here: both frames of every pair.
  const DecodeReport hot = Decode(Shoot(rig_, 0, kBall, {.global = 2.0, .white_dn = 40000.0}));
  EXPECT_GT(hot.counts[static_cast<int>(DecodeReason::kSaturated)], 1000);
  for (size_t s = 0; s < hot.map.reason.size(); ++s)
    if (hot.map.reason.data()[s] != 0) {
      ASSERT_TRUE(std::isnan(hot.map.column.data()[s]));
    }
}

TEST_F(GrayDecoder, RefusesAnIncompleteCode) {
  const Frames frames = Shoot(rig_, 0, kBall, {});
  DecodeInput input = frames.Decode(rig_.projectors[0], kPeriodPx);
  input.rows.bits.pop_back();
  const auto report = DecodeGray(input, SensorNoise::From(rig_.camera));
  ASSERT_FALSE(report.ok());
  EXPECT_EQ(report.status().code(), StatusCode::kUsage);
  EXPECT_NE(report.status().message().find("rows"), std::string::npos);
}

TEST_F(GrayDecoder, CallsSitesThatSaturateInTheDarkSaturatedNotUnlit) {
  const DecodeReport glare = Decode(Shoot(rig_, 0, kBall, {.ambient_dn = 40000.0}));
  EXPECT_EQ(glare.counts[static_cast<int>(DecodeReason::kSaturated)], static_cast<int64_t>(glare.map.reason.size()));
}

}  // namespace
}  // namespace stratalux::fit
