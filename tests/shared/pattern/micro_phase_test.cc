// SPDX-License-Identifier: Apache-2.0
#include "shared/pattern/micro_phase.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "shared/pattern/column_code.h"
#include "shared/pattern/pattern.h"

namespace stratalux {
namespace {

// What a plane's pair differs by at a column, for a site of white less black 1 and no blur; `contrast`: of plane b.
std::vector<double> Seen(double column, int bits, int about_px, const std::vector<double>& contrast = {}) {
  std::vector<double> difference;
  for (int plane = 0; plane < bits; ++plane) {
    const double c = contrast.empty() ? 1.0 : contrast[static_cast<size_t>(plane)];
    difference.push_back(c * std::cos(MicroPhaseWave(plane, bits, about_px).Angle(column)));
  }
  return difference;
}

TEST(MicroPhase, HasPeriodsWithinAFifthOfTheOneAskedForAndTwoPlanesOfEach) {
  for (int bits = 4; bits <= kMaxCodeBits; ++bits)
    for (int plane = 0; plane < bits; ++plane) {
      const Wave wave = MicroPhaseWave(plane, bits, 8);
      EXPECT_NEAR(8.0 / wave.period_px, 1.0, 0.2);
      EXPECT_EQ(wave.period_px, MicroPhaseWave(plane & ~1, bits, 8).period_px);
      EXPECT_NEAR(wave.phase_rad, plane % 2 * 0.5 * std::numbers::pi, 1e-12);
    }
}

// By how much the phases of two columns differ at least, half a period apart and more: of the square of a plane's
// contrast, whatever the contrast is.
TEST(MicroPhase, TellsColumnsApartWhereverTheyAre) {
  for (int bits = 4; bits <= 13; ++bits)
    for (const int about : {4, 8}) {
      const int periods = (bits + 1) / 2;
      double closest = 1e9;
      for (double distance = 0.5 * about; distance < 1 << bits; distance += 0.125) {
        double together = 0.0;
        for (int j = 0; j < periods; ++j)
          together += std::cos(2.0 * std::numbers::pi * distance / MicroPhaseWave(2 * j, bits, about).period_px);
        together = std::max(0.0, together / periods);
        closest = std::min(closest, periods * (1.0 - together * together));
      }
      std::printf("%d bits, period %d: %.2f\n", bits, about, closest);
      EXPECT_GT(closest, bits <= 4 ? 0.8 : bits <= 6 ? 1.1 : 1.4) << bits << " bits, period " << about;
    }
}

TEST(MicroPhase, FindsEveryColumnByItselfAndWithASinusoid) {
  for (const int about : {6, 8}) {
    const int bits = 10, count = 1000;
    const MicroPhaseSearch search(count, bits, about);
    const std::vector<double> weight(bits, 1e4);
    for (double column = -0.4; column < count - 0.6; column += 0.7) {
      const std::vector<double> seen = Seen(column, bits, about);
      const auto alone = search.Find(seen, weight);
      ASSERT_NEAR(alone.column, column, 1e-3);
      ASSERT_LT(alone.astray, 1e-6);
      const double within = std::fmod(column + 0.5, about);
      const auto with = search.Find(seen, weight, MicroPhaseSearch::Within{within, 0.01});
      ASSERT_NEAR(with.column, column, 1e-3);
      ASSERT_LT(with.astray, 1e-6);
      ASSERT_LT(with.sigma_px, alone.sigma_px);
    }
  }
}

// Blur takes more of finer waves. Then a period's phase is as true as ever.
TEST(MicroPhase, ContrastsThatDifferMoveNoColumn) {
  const int bits = 10, about = 8;
  MicroPhaseSearch search(1024, bits, about);
  std::vector<double> contrast, squares;
  for (int plane = 0; plane < bits; ++plane)
    contrast.push_back(
        std::exp(-2.0 * std::pow(std::numbers::pi * 1.8 / MicroPhaseWave(plane, bits, about).period_px, 2)));
  EXPECT_GT(*std::max_element(contrast.begin(), contrast.end()),
            1.3 * *std::min_element(contrast.begin(), contrast.end()));
  for (const double c : contrast) squares.push_back(c * c);
  for (const bool learnt : {false, true}) {
    if (learnt) search.LearnContrast(squares);
    for (double column = 0.0; column < 1023.0; column += 3.3) {
      const auto found = search.Find(Seen(column, bits, about, contrast), std::vector<double>(bits, 1e3));
      ASSERT_NEAR(found.column, column, 1e-3);
      ASSERT_LT(found.astray, learnt ? 1e-7 : 1e-2) << column;
    }
  }
}

TEST(MicroPhase, SaysHowFarItMayBeOffAndNeverASureWrongPeriod) {
  const int bits = 10, about = 8, count = 1024;
  const MicroPhaseSearch search(count, bits, about);
  Random random(7, 0);
  for (const double sigma : {0.05, 0.2, 0.4, 1.0, 3.0}) {
    const std::vector<double> weight(bits, 1.0 / (sigma * sigma));
    int sure = 0, wrong = 0;
    double squares = 0.0;
    constexpr int kTries = 4000;
    for (int n = 0; n < kTries; ++n) {
      const double column = random.Uniform() * (count - 1);
      std::vector<double> seen = Seen(column, bits, about);
      for (double& d : seen) d += sigma * random.Normal();
      const auto found = search.Find(seen, weight);
      if (found.astray > 1e-4) continue;
      ++sure;
      const double off = found.column - column;
      if (std::abs(off) > 0.5 * about)
        ++wrong;
      else
        squares += off * off / (found.sigma_px * found.sigma_px);
    }
    std::printf("noise %.2f of the contrast: %.1f %% sure, %d of them wrong, error over sigma %.2f\n", sigma,
                100.0 * sure / kTries, wrong, std::sqrt(squares / std::max(1, sure - wrong)));
    EXPECT_LE(wrong, 3) << sigma;  // of 4,000 at 1e-4
    EXPECT_GE(sure, sigma <= 0.1 ? kTries : 0);
    EXPECT_LE(sure, sigma >= 3.0 ? kTries / 100 : kTries);
    if (sure < 1000) continue;
    EXPECT_NEAR(std::sqrt(squares / (sure - wrong)), 0.85, 0.2);  // sigma is widened, never narrowed
  }
}

TEST(MicroPhase, OfPlanesThatSayNothingIsFoundByTheOthers) {
  const int bits = 10;
  const MicroPhaseSearch search(1024, bits, 8);
  for (int lost = 0; lost < bits; ++lost) {
    std::vector<double> seen = Seen(517.3, bits, 8), weight(bits, 1e4);
    seen[static_cast<size_t>(lost)] = 1e6;
    weight[static_cast<size_t>(lost)] = 0.0;
    const auto found = search.Find(seen, weight);
    EXPECT_NEAR(found.column, 517.3, 1e-3);
    EXPECT_LT(found.astray, 1e-4);
  }
  EXPECT_GT(search.Find(std::vector<double>(bits, 0.3), std::vector<double>(bits, 0.0)).astray, 0.99);
  EXPECT_GT(search.Find(std::vector<double>(bits, 0.0), std::vector<double>(bits, 1e4)).astray, 0.9);
}

TEST(MicroPhase, IsShownAsItIsSearchedAndKeepsItsText) {
  for (int plane = 0; plane < 10; ++plane)
    for (const bool inverse : {false, true}) {
      const Pattern p{.kind = PatternKind::kGray,
                      .axis = PatternAxis::kRows,
                      .bit = plane,
                      .bits = 10,
                      .inverse = inverse,
                      .code = ColumnCode::kMicroPhase,
                      .period = 8};
      EXPECT_TRUE(p.Validate(1024, 768).ok());
      EXPECT_TRUE(p.HasLevels());
      const auto again = Pattern::Parse(p.ToString());
      ASSERT_TRUE(again.ok());
      EXPECT_EQ(*again, p);
      for (const int row : {0, 1, 300, 767})
        EXPECT_NEAR(p.Intensity(5, row),
                    0.5 + (inverse ? -0.5 : 0.5) * std::cos(MicroPhaseWave(plane, 10, 8).Angle(row)), 1e-6);
    }
  const Pattern none{.kind = PatternKind::kGray, .bit = 0, .bits = 10, .code = ColumnCode::kMicroPhase};
  EXPECT_EQ(none.ToString(), "gray columns bit=0/10 code=micro-phase period=0");
  EXPECT_FALSE(none.Validate(1024, 768).ok());
}

TEST(MicroPhase, IsTheSameForEver) {
  // Stored sessions were projected with it.
  double sum = 0.0;
  for (int bits = 1; bits <= kMaxCodeBits; ++bits)
    for (int plane = 0; plane < bits; ++plane) sum += (plane + 1) * MicroPhaseWave(plane, bits, 8).period_px;
  EXPECT_NEAR(sum, 6293.5127399006, 1e-6);
}

}  // namespace
}  // namespace stratalux
