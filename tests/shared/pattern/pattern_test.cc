// SPDX-License-Identifier: Apache-2.0
#include "shared/pattern/pattern.h"

#include <cmath>

#include <gtest/gtest.h>

namespace stratalux {
namespace {

TEST(CodePattern, BitsSpellTheColumnAndInverseIsComplement) {
  const int bits = GrayBits(1024);
  ASSERT_EQ(bits, 10);
  for (const ColumnCode code : {ColumnCode::kGray, ColumnCode::kXor2, ColumnCode::kXor4, ColumnCode::kMinStripe})
    for (int column = 0; column < 1024; column += 7) {
      unsigned word = 0;
      for (int bit = 0; bit < bits; ++bit) {
        const Pattern p{.kind = PatternKind::kGray, .bit = bit, .bits = bits, .code = code};
        Pattern q = p;
        q.inverse = true;
        EXPECT_EQ(p.Intensity(column, 3) + q.Intensity(column, 3), 1.0F);
        word = word << 1 | static_cast<unsigned>(p.Intensity(column, 3));
      }
      EXPECT_EQ(ColumnOf(code, word, bits), static_cast<unsigned>(column)) << ToString(code);
    }
}

TEST(CombPattern, CycleAddsUpToWidthOverStepWhites) {
  for (int step : {1, 2}) {
    std::vector<float> sum(512, 0.0F);
    for (int shift = 0; shift < 128; shift += step) {
      const auto profile = Pattern{.kind = PatternKind::kComb, .period = 128, .width = 2, .shift = shift}.Profile(512);
      for (int c = 0; c < 512; ++c) sum[c] += profile[c];
    }
    for (float s : sum) EXPECT_EQ(s, 2.0F / static_cast<float>(step));
  }
}

TEST(SinusoidPattern, ShiftsAddUpToAConstantAndPhaseFollowsTheColumn) {
  for (int column = 0; column < 40; ++column) {
    double sum = 0.0, in_phase = 0.0, quadrature = 0.0;
    for (int shift = 0; shift < 4; ++shift) {
      const double i =
          Pattern{.kind = PatternKind::kSinusoid, .period = 8, .shift = shift, .shifts = 4}.Intensity(column, 0);
      sum += i;
      in_phase += i * std::cos(2.0 * M_PI * shift / 4);
      quadrature += i * std::sin(2.0 * M_PI * shift / 4);
    }
    EXPECT_NEAR(sum, 2.0, 1e-6);
    const double phase = std::atan2(quadrature, in_phase) / (2.0 * M_PI) * 8.0;
    EXPECT_NEAR(std::remainder(phase - (column + 0.5), 8.0), 0.0, 1e-5);
  }
}

TEST(CheckerboardPattern, LightsHalfThePixelsAndShiftsCoverAllEqually) {
  Image<float> sum(16, 16);
  for (int shift = 0; shift < 4; ++shift) {
    const auto image =
        Pattern{.kind = PatternKind::kCheckerboard, .period = 8, .shift = shift, .shifts = 2}.Render(16, 16);
    for (size_t i = 0; i < sum.size(); ++i) sum.pixels()[i] += image.pixels()[i];
  }
  for (float s : sum.pixels()) EXPECT_EQ(s, 2.0F);
}

TEST(PatternText, RoundTripsEveryKind) {
  const std::vector<Pattern> patterns = {
      {.kind = PatternKind::kBlack},
      {.kind = PatternKind::kWhite},
      {.kind = PatternKind::kGray, .axis = PatternAxis::kRows, .bit = 3, .bits = 10, .inverse = true},
      {.kind = PatternKind::kGray, .bit = 0, .bits = 10, .code = ColumnCode::kXor2},
      {.kind = PatternKind::kGray, .bit = 9, .bits = 10, .inverse = true, .code = ColumnCode::kXor4},
      {.kind = PatternKind::kGray, .axis = PatternAxis::kRows, .bit = 4, .bits = 10, .code = ColumnCode::kMinStripe},
      {.kind = PatternKind::kCheckerboard, .period = 8, .shift = 3, .shifts = 2},
      {.kind = PatternKind::kSinusoid, .axis = PatternAxis::kColumns, .period = 8, .shift = 1, .shifts = 4},
      {.kind = PatternKind::kComb, .axis = PatternAxis::kRows, .period = 128, .width = 2, .shift = 126},
      {.kind = PatternKind::kSpots, .period = 160, .width = 4}};
  for (const Pattern& p : patterns) {
    const auto parsed = Pattern::Parse(p.ToString());
    ASSERT_TRUE(parsed.ok()) << parsed.status().message();
    EXPECT_EQ(*parsed, p) << p.ToString();
  }
}

TEST(PatternText, RefusesWhatItDoesNotKnow) {
  for (const char* text : {"", "grey columns bit=1/2", "grey", "comb level=1/2", "gray columns bit=x/2",
                           "comb period=", "sinusoid columns nonsense"})
    EXPECT_EQ(Pattern::Parse(text).status().code(), StatusCode::kUsage) << text;
}

TEST(PatternText, SaysWhichCodeButForTheReflectedOne) {
  Pattern pattern{.kind = PatternKind::kGray, .bit = 3, .bits = 10, .inverse = true};
  EXPECT_EQ(pattern.ToString(), "gray columns bit=3/10 inverse");  // as every session before there were others
  EXPECT_EQ(Pattern::Parse("gray columns bit=3/10 inverse")->code, ColumnCode::kGray);
  pattern.code = ColumnCode::kXor4;
  EXPECT_EQ(pattern.ToString(), "gray columns bit=3/10 inverse code=xor-4");
  const auto later = Pattern::Parse("gray columns bit=3/10 code=xor-8");
  ASSERT_EQ(later.status().code(), StatusCode::kUsage);
  EXPECT_NE(later.status().message().find("code 'xor-8' is unknown; allowed: gray, xor-2"), std::string::npos);
  EXPECT_EQ(Pattern::Parse("comb columns period=8 width=2 shift=0 code=xor-4").status().code(), StatusCode::kUsage);
  EXPECT_EQ(Pattern::Parse("gray columns bit=3/10 period=8").status().code(), StatusCode::kUsage);
}

TEST(PatternValidate, RefusesWhatNoProjectorCanShow) {
  EXPECT_TRUE((Pattern{.kind = PatternKind::kComb, .period = 128, .width = 2}.Validate(1024, 768).ok()));
  EXPECT_FALSE((Pattern{.kind = PatternKind::kComb, .period = 2048, .width = 2}.Validate(1024, 768).ok()));
  EXPECT_FALSE((Pattern{.kind = PatternKind::kComb, .period = 0, .width = 2}.Validate(1024, 768).ok()));
  EXPECT_FALSE((Pattern{.kind = PatternKind::kGray, .bit = 0, .bits = 11}.Validate(1024, 768).ok()));
  EXPECT_FALSE(
      (Pattern{.kind = PatternKind::kSinusoid, .period = 8, .shift = 4, .shifts = 4}.Validate(1024, 768).ok()));
}

TEST(Pattern, GreyLevelsAreEvenAndNamed) {
  const Pattern grey{.kind = PatternKind::kGrey, .shift = 5, .shifts = 32};
  EXPECT_EQ(grey.ToString(), "grey level=5/32");
  ASSERT_TRUE(Pattern::Parse(grey.ToString()).ok());
  EXPECT_EQ(*Pattern::Parse(grey.ToString()), grey);
  EXPECT_FLOAT_EQ(grey.Intensity(3, 700), 5.0F / 32.0F);
  EXPECT_TRUE(grey.Validate(64, 48).ok());
  EXPECT_FALSE((Pattern{.kind = PatternKind::kGrey, .shift = 33, .shifts = 32}).Validate(64, 48).ok());
  EXPECT_FALSE(Pattern::Parse("grey level=5").ok());
}

}  // namespace
}  // namespace stratalux
