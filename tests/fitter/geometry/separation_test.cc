// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "fitter/separation/separate.h"
#include "fitter/separation/shrink_noise.h"
#include "shared/base/random.h"
#include "shared/pattern/pattern.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 32, kHeight = 24;
constexpr double kBlackDn = 64.0;
const SensorNoise kNoise{.black_level_dn = kBlackDn, .gain_e_per_dn = 4.0, .read_noise_dn = 3.0};

// A Bayer mosaic where each projector pixel falls on one site: L = ambient + L_d p + L_g mean(p), per colour.
struct Mixture {
  double direct[3] = {400, 300, 200};
  double global[3] = {900, 500, 150};
  double projector_black = 0.0;
  double ambient = 25.0;
  double gamma = 1.0;  // light of grey level v: v^gamma

  // Mean light of an even pattern: over one period for sinusoids.
  [[nodiscard]] double MeanOf(const Pattern& pattern) const {
    if (pattern.kind == PatternKind::kWhite || pattern.kind == PatternKind::kBlack) return pattern.Intensity(0, 0);
    if (pattern.kind == PatternKind::kCheckerboard) return 0.5;
    double sum = 0.0;
    for (int k = 0; k < 64; ++k) sum += std::pow(0.5 + 0.5 * std::cos(6.283185307179586 * k / 64), gamma) / 64;
    return sum;
  }
  [[nodiscard]] Image<uint16_t> Frame(const Pattern& pattern) const {
    const double mean = MeanOf(pattern);
    const auto shown = [&](double v) { return projector_black + (1.0 - projector_black) * v; };
    Image<uint16_t> frame(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const int c = CfaColour(Cfa::kRggb, x, y);
        frame(x, y) = static_cast<uint16_t>(std::lround(kBlackDn + ambient +
                                                        direct[c] * shown(std::pow(pattern.Intensity(x, y), gamma)) +
                                                        global[c] * shown(mean)));
      }
    return frame;
  }
};

struct Shots {
  std::vector<Image<uint16_t>> columns, rows, checkers;
  Image<uint16_t> white;
  Image<float> black{kWidth, kHeight};

  explicit Shots(const Mixture& mixture) : white(mixture.Frame({.kind = PatternKind::kWhite})) {
    const Image<uint16_t> dark = mixture.Frame({.kind = PatternKind::kBlack});
    std::copy(dark.pixels().begin(), dark.pixels().end(), black.pixels().begin());
    for (int shift = 0; shift < 4; ++shift) {
      Pattern p{.kind = PatternKind::kSinusoid, .period = 8, .shift = shift, .shifts = 4};
      columns.push_back(mixture.Frame(p));
      p.axis = PatternAxis::kRows;
      rows.push_back(mixture.Frame(p));
      checkers.push_back(mixture.Frame({.kind = PatternKind::kCheckerboard, .period = 8, .shift = shift, .shifts = 2}));
    }
  }
  [[nodiscard]] SeparationFrames Views() const {
    SeparationFrames f{.white = white.view(), .black = black.view()};
    for (const auto& v : columns) f.column_shifts.push_back(v.view());
    for (const auto& v : rows) f.row_shifts.push_back(v.view());
    for (const auto& v : checkers) f.checkerboards.push_back(v.view());
    return f;
  }
};

void ExpectMixture(const Separation& s, const Mixture& m, double tolerance_dn) {
  ASSERT_EQ(s.counts[0], kWidth / 2 * kHeight / 2);
  for (int j = 0; j < kHeight / 2; ++j)
    for (int i = 0; i < kWidth / 2; ++i)
      for (int c = 0; c < 3; ++c) {
        ASSERT_NEAR(s.map.direct(i, j, c), m.direct[c], tolerance_dn);
        ASSERT_NEAR(s.map.global(i, j, c), m.global[c], tolerance_dn);
        ASSERT_NEAR(s.map.white(i, j, c), m.direct[c] + m.global[c], tolerance_dn);
      }
}

TEST(SeparateSinusoids, IsExactOnMixtures) {
  const Mixture mixture;
  const Shots shots(mixture);
  const auto s = SeparateSinusoids(shots.Views(), Cfa::kRggb, kNoise);
  ASSERT_TRUE(s.ok()) << s.status().message();
  ExpectMixture(*s, mixture, 2.0);  // whole digital numbers
}

TEST(SeparateSinusoids, TakesTheProjectorsBlackIntoAccount) {
  const Mixture mixture{.projector_black = 0.1};
  const Shots shots(mixture);
  ExpectMixture(*SeparateSinusoids(shots.Views(), Cfa::kRggb, kNoise, {.projector_black = 0.1}), mixture, 2.0);
}

// Mean over the map of the direct light, all colours, relative to the truth.
double MeanDirectError(const Separation& s, const Mixture& m) {
  double sum = 0.0, truth = 0.0;
  for (int j = 0; j < kHeight / 2; ++j)
    for (int i = 0; i < kWidth / 2; ++i)
      for (int c = 0; c < 3; ++c) {
        sum += s.map.direct(i, j, c);
        truth += m.direct[c];
      }
  return sum / truth - 1.0;
}

TEST(SeparateSinusoids, TheResponseOfTheProjectorGivesTheLinearRigsSplit) {
  for (const double gamma : {1.4, 2.2, 2.4}) {
    const Mixture mixture{.gamma = gamma};
    const Shots shots(mixture);
    ProjectorCalibration projector;
    for (int k = 0; k <= 32; ++k) projector.response.push_back(std::pow(k / 32.0, gamma));
    const auto blind = SeparateSinusoids(shots.Views(), Cfa::kRggb, kNoise);
    const auto known =
        SeparateSinusoids(shots.Views(), Cfa::kRggb, kNoise, {.sinusoid_amplitude = projector.SinusoidAmplitude()});
    ASSERT_TRUE(blind.ok() && known.ok());
    EXPECT_LT(std::abs(MeanDirectError(*known, mixture)), 0.003) << gamma;
    EXPECT_GT(std::abs(MeanDirectError(*blind, mixture)), 0.01) << gamma;
  }
  const Shots shots{Mixture{}};
  EXPECT_EQ(SeparateSinusoids(shots.Views(), Cfa::kRggb, kNoise, {.sinusoid_amplitude = 0.0}).status().code(),
            StatusCode::kUsage);
}

TEST(SeparateCheckerboards, IsExactOnMixtures) {
  for (double black : {0.0, 0.1}) {
    const Mixture mixture{.projector_black = black};
    const Shots shots(mixture);
    ExpectMixture(*SeparateCheckerboards(shots.Views(), Cfa::kRggb, kNoise, {.projector_black = black}), mixture, 2.0);
  }
}

TEST(Separate, OfWhiteAloneNothingIsDirect) {
  const Shots shots{Mixture{}};
  const auto both = SeparateSinusoids(shots.Views(), Cfa::kRggb, kNoise),
             alone = WhiteAlone(shots.Views(), Cfa::kRggb, kNoise);
  ASSERT_TRUE(both.ok() && alone.ok());
  EXPECT_EQ(alone->counts[static_cast<int>(SeparationReason::kNotTold)], kWidth / 2 * kHeight / 2);
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(alone->map.white(3, 3, c), both->map.white(3, 3, c));
    for (const auto* map : {&alone->map.direct, &alone->map.global, &alone->map.direct_variance})
      EXPECT_TRUE(std::isnan((*map)(3, 3, c)));
  }
}

TEST(Separate, IsInvariantToAmbientLight) {
  const Mixture mixture{.ambient = 700.0};
  const Shots shots(mixture);
  ExpectMixture(*SeparateSinusoids(shots.Views(), Cfa::kRggb, kNoise), mixture, 2.0);
  ExpectMixture(*SeparateCheckerboards(shots.Views(), Cfa::kRggb, kNoise), mixture, 2.0);
}

TEST(Separate, MasksInsteadOfClipping) {
  const Mixture negative{.global = {-200, -150, -100}};  // a pattern whose contrast exceeds its white
  const auto n = SeparateSinusoids(Shots(negative).Views(), Cfa::kRggb, kNoise);
  EXPECT_EQ(n->counts[static_cast<int>(SeparationReason::kNegative)], kWidth / 2 * kHeight / 2);
  EXPECT_TRUE(std::isnan(n->map.global(3, 3, 0)));

  const Mixture dark{.direct = {1, 1, 1}, .global = {1, 1, 1}};
  const auto d = SeparateSinusoids(Shots(dark).Views(), Cfa::kRggb, kNoise);
  EXPECT_EQ(d->counts[static_cast<int>(SeparationReason::kUnlit)], kWidth / 2 * kHeight / 2);

  // Kept with its noise, but no valid direct light.
  EXPECT_NEAR(d->map.direct(3, 3, 0), 1.0, 4.0 * std::sqrt(d->map.direct_variance(3, 3, 0)));
  EXPECT_TRUE(std::isnan(d->map.global(3, 3, 0)));
  EXPECT_TRUE(std::isnan(ValidDirect(d->map)(3, 3, 0)));

  const Mixture bright{.direct = {4000, 100, 100}};
  const auto b = SeparateSinusoids(Shots(bright).Views(), Cfa::kRggb, kNoise);
  EXPECT_EQ(b->counts[static_cast<int>(SeparationReason::kSaturated)], kWidth / 2 * kHeight / 2);
}

TEST(Separate, RefusesTooFewPatterns) {
  const Shots shots{Mixture{}};
  SeparationFrames views = shots.Views();
  views.column_shifts.resize(2);
  EXPECT_EQ(SeparateSinusoids(views, Cfa::kRggb, kNoise).status().code(), StatusCode::kUsage);
}

// A disc of `height` in a plane of 1, noise of standard deviation 0.1.
struct NoisyDisc {
  Image<float> truth{64, 64, 1}, noisy{64, 64, 1}, variance{64, 64, 1, 0.01F};
  explicit NoisyDisc(float height) {
    Random random(5);
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x) {
        truth(x, y) = std::hypot(x - 32.0, y - 32.0) < 10.0 ? 1.0F + height : 1.0F;
        noisy(x, y) = truth(x, y) + 0.1F * static_cast<float>(random.Normal());
      }
  }
  // Mean squared error over the noise's, of pixels nearer than `reach` to the rim or of all the others.
  [[nodiscard]] double Error(const Image<float>& image, bool at_rim) const {
    double sum = 0.0, count = 0.0;
    for (int y = 4; y < 60; ++y)
      for (int x = 4; x < 60; ++x) {
        if ((std::abs(std::hypot(x - 32.0, y - 32.0) - 10.0) < 5.0) != at_rim) continue;
        sum += std::pow(double(image(x, y)) - truth(x, y), 2) / 0.01;
        count += 1.0;
      }
    return sum / count;
  }
};

TEST(ShrinkNoise, TakesNoiseAndLeavesWhatStandsOut) {
  const NoisyDisc disc(3.0F);
  const Image<float> quiet = ShrinkNoise(disc.noisy, disc.variance, 3);
  EXPECT_LT(disc.Error(quiet, false), 0.1);
  EXPECT_LT(disc.Error(quiet, true), 1.3);  // an edge of thirty standard deviations: hardly touched
  EXPECT_GT(disc.Error(disc.noisy, false), 0.9);
}

TEST(ShrinkNoise, WithoutNoiseIsTheImage) {
  NoisyDisc disc(3.0F);
  std::fill(disc.variance.pixels().begin(), disc.variance.pixels().end(), 0.0F);
  const Image<float> same = ShrinkNoise(disc.noisy, disc.variance, 3);
  for (size_t k = 0; k < same.size(); ++k) EXPECT_NEAR(same.pixels()[k], disc.noisy.pixels()[k], 1e-5);
}

TEST(ShrinkNoise, WhatIsNotMeasuredBecomesItsNeighboursMean) {
  NoisyDisc disc(0.0F);
  disc.noisy(20, 20) = 50.0F;  // says nothing
  disc.variance(20, 20) = INFINITY;
  const Image<float> quiet = ShrinkNoise(disc.noisy, disc.variance, 3);
  EXPECT_NEAR(quiet(20, 20), 1.0, 0.06);
  EXPECT_NEAR(quiet(21, 20), 1.0, 0.15) << "it has a part in no other";
  const Image<float> all(64, 64, 1, INFINITY);
  EXPECT_TRUE(std::isnan(ShrinkNoise(disc.noisy, all, 3)(20, 20)));
}

TEST(ShrinkNoise, UnknownPixelsStayUnknownAndSpoilNoOther) {
  NoisyDisc disc(0.0F);
  disc.noisy(20, 20) = std::nanf("");
  disc.variance(40, 40) = std::nanf("");
  const Image<float> quiet = ShrinkNoise(disc.noisy, disc.variance, 3);
  EXPECT_TRUE(std::isnan(quiet(20, 20)));
  EXPECT_TRUE(std::isnan(quiet(40, 40)));
  EXPECT_TRUE(std::isfinite(quiet(21, 20)));
}

}  // namespace
}  // namespace stratalux::fit
