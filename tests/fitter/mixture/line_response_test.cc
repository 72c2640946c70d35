// SPDX-License-Identifier: Apache-2.0
// The line response of samples that average several sites, held to single sites and to the box that many become.
#include "fitter/mixture/line_response.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/normal_table.h"
#include "shared/geometry/pixel_box.h"
#include "tests/fitter/mixture/known_lights.h"

namespace stratalux::fit {
namespace {

TEST(NormalTable, IsTheNormalDistributionAndItsAntiderivative) {
  for (double x = -9.0; x <= 9.0; x += 0.0137) {
    const double below = 0.5 * std::erfc(-x / std::numbers::sqrt2),
                 density = std::exp(-0.5 * x * x) / std::sqrt(2 * std::numbers::pi);
    ASSERT_NEAR(NormalBelow(x), below, 1e-10) << x;
    ASSERT_NEAR(NormalRamp(x), x * below + density, 1e-11) << x;
  }
}

constexpr double kLineMm = 0.58, kBlurMm = 0.15, kCellMm = 0.145;

LineResponse Pooled(const SampleSites& sites, double cell_mm = kCellMm) {
  return {kLineMm, kBlurMm, 0.0, cell_mm, sites};
}

// Places of the sites, written out.
std::vector<double> PlacesOf(const SampleSites& s) {
  std::vector<double> places;
  for (int j = 0; j < s.pool; ++j)
    for (int i = 0; i < s.pool; ++i)
      for (double pair : {-s.pair_mm, s.pair_mm})
        places.push_back((i - (s.pool - 1) / 2.0) * s.quad_x_mm + (j - (s.pool - 1) / 2.0) * s.quad_y_mm + pair);
  return places;
}

TEST(PooledSites, SeeTheMeanOfWhatEachSees) {
  const LineResponse one = Pooled({});
  for (const SampleSites& sites :
       {SampleSites{1, 0.8, 0.3, 0.2}, SampleSites{2, 0.8, 0.3, 0.0}, SampleSites{2, 0.8, 0.0, 0.2},
        SampleSites{3, -0.4, 0.4, 0.1}, SampleSites{4, 0.0, 0.0, 0.0}}) {
    SCOPED_TRACE(sites.pool);
    const LineResponse line = Pooled(sites);
    const std::vector<double> cells = line.OnCells(-2.9, 40), places = PlacesOf(sites);
    for (int i = 0; i < 40; ++i) {
      double mean = 0.0;
      for (double place : places) mean += one.At(-2.9 + i * kCellMm - place) / static_cast<double>(places.size());
      EXPECT_NEAR(cells[i], mean, 1e-10) << i;
      EXPECT_NEAR(line.At(-2.9 + i * kCellMm), mean, 1e-10) << i;
    }
  }
}

TEST(SampleSites, TwoGaussiansAreNearTheBoxThatTheyStandFor) {
  // A pixel three lines long, as under grazing view: its box averages the response of a point.
  constexpr double kBoxMm = 1.2;
  const auto of_box = [&](double t) {
    constexpr int kPoints = 400;
    double mean = 0.0;
    for (int k = 0; k < kPoints; ++k) mean += Pooled({}).At(t + ((k + 0.5) / kPoints - 0.5) * kBoxMm) / kPoints;
    return mean;
  };
  const double gaussian_mm = std::hypot(kBlurMm, kBoxMm * std::sqrt(kBoxVariance)),
               part_mm = std::hypot(kBlurMm, kBoxMm * std::sqrt(kHalfBoxVariance));
  const LineResponse one{kLineMm, gaussian_mm, 0.0, kCellMm, {}};
  const LineResponse two{kLineMm, part_mm, 0.0, kCellMm, {.box_x_mm = kHalfBoxPlace * kBoxMm}};
  double worst_one = 0.0, worst_two = 0.0;
  for (double t = -2.0; t <= 2.0; t += 0.05) {
    worst_one = std::max(worst_one, std::abs(one.At(t) - of_box(t)));
    worst_two = std::max(worst_two, std::abs(two.At(t) - of_box(t)));
  }
  EXPECT_NEAR(of_box(0.0), kLineMm / kBoxMm, 0.01);  // all of the line, and nothing else
  EXPECT_LT(worst_two, 0.02);
  EXPECT_GT(worst_one, 0.05);
  EXPECT_NEAR(two.sites.VarianceMm2() + part_mm * part_mm, gaussian_mm * gaussian_mm, 1e-9);
}

TEST(SampleSites, OfTwoBoxesAreEightAndShareTheSample) {
  const SampleSites sites{.pair_mm = 0.2, .box_x_mm = 0.3, .box_y_mm = -0.1};
  double sum = 0.0, mean = 0.0, variance = 0.0;
  int count = 0;
  sites.ForEach([&](double at, double share) {
    sum += share;
    mean += share * at;
    variance += share * at * at;
    ++count;
    EXPECT_LE(std::abs(at), sites.ReachMm() + 1e-12);
  });
  EXPECT_EQ(count, 8);
  EXPECT_NEAR(sum, 1.0, 1e-12);
  EXPECT_NEAR(mean, 0.0, 1e-12);
  EXPECT_NEAR(variance, sites.VarianceMm2(), 1e-12);
}

TEST(PooledSites, SeeAlikeWhicheverWayTheImagesAxesRun) {
  const LineResponse line = Pooled({3, 0.7, 0.25, 0.1});
  for (const SampleSites& same : {SampleSites{3, -0.7, 0.25, 0.1}, SampleSites{3, 0.7, -0.25, 0.1},
                                  SampleSites{3, 0.25, 0.7, 0.1}, SampleSites{3, 0.7, 0.25, -0.1}})
    for (double t : {-1.3, -0.4, 0.0, 0.2, 0.9}) {
      EXPECT_NEAR(Pooled(same).At(t), line.At(t), 1e-12);
      EXPECT_NEAR(line.At(-t), line.At(t), 1e-10);
    }
}

TEST(PooledSites, AddTheirOwnVarianceAndEndWhereTheSupportDoes) {
  const SampleSites sites{4, 0.8, 0.3, 0.2};
  constexpr double kFine = 0.01;
  const LineResponse line = Pooled(sites, kFine);
  const int half = 500;
  const std::vector<double> cells = line.OnCells(-half * kFine, 2 * half + 1);
  double sum = 0.0, second = 0.0;
  for (int i = -half; i <= half; ++i) {
    sum += cells[i + half];
    second += cells[i + half] * i * kFine * i * kFine;
    if (std::abs(i) * kFine > line.Support()) {
      EXPECT_LT(cells[i + half], 1e-6) << i;
    }
  }
  EXPECT_NEAR(sum * kFine, kLineMm, 1e-6);
  EXPECT_NEAR(second / sum, kLineMm * kLineMm / 12.0 + kBlurMm * kBlurMm + kFine * kFine / 12.0 + sites.VarianceMm2(),
              1e-4);
}

TEST(PooledSites, ThatAreManyAndDenseAreABox) {
  constexpr int kMany = 100;
  const LineResponse many = Pooled({kMany, 2.0 / kMany, 0.0, 0.0}), box{kLineMm, kBlurMm, 2.0, kCellMm, {}};
  for (double t : {0.0, 0.5, 0.9, 1.1, 1.6}) EXPECT_NEAR(many.At(t), box.At(t), 1e-4);
}

// Combs of known layers under three lights, each sample the mean of what single sites would read.
std::vector<SrdBatch> PooledProfiles(const SampleSites& sites, const EmOptions& options) {
  std::vector<SrdBatch> lights;
  Random random(1);
  for (double slope : {-1.0, 0.0, 0.58}) {
    SrdBatch b = test::CombOf(test::FiveLayers(), slope, 4, 0.0, options, random);
    std::fill(b.y.begin(), b.y.end(), 0.0F);
    const std::vector<double> places = PlacesOf(sites);
    for (double place : places) {
      SrdBatch one = b;  // a line is nearer to a site that lies towards it
      for (float& u : one.first_u_mm) u -= static_cast<float>(place);
      for (int64_t i = 0; i < b.profiles(); ++i) {
        const auto y = PredictSamples(test::FiveLayers(), one, i, options.scattering);
        for (int k = 0; k < b.samples; ++k)
          b.y[i * b.samples + k] += static_cast<float>(y[k] / static_cast<double>(places.size()));
      }
    }
    b.pool = sites.pool;
    b.quad_x_mm.assign(b.valid.size(), static_cast<float>(sites.quad_x_mm));
    b.quad_y_mm.assign(b.valid.size(), static_cast<float>(sites.quad_y_mm));
    b.pair_mm.assign(b.valid.size(), static_cast<float>(sites.pair_mm));
    lights.push_back(std::move(b));
  }
  return lights;
}

// The same, with the places of the sites taken for a Gaussian of their variance.
SrdBatch AsGaussian(SrdBatch b) {
  for (size_t i = 0; i < b.blur_mm.size(); ++i)
    b.blur_mm[i] = static_cast<float>(
        std::sqrt(b.blur_mm[i] * b.blur_mm[i] + SampleSitesOf(b, static_cast<int64_t>(i)).VarianceMm2()));
  b.pool = 1;
  b.pair_mm.clear();
  return b;
}

double WorstOfPrediction(const SrdBatch& b, const EmOptions& options) {
  double worst = 0.0, peak = 0.0;
  for (int64_t i = 0; i < b.profiles(); ++i) {
    const auto y = PredictSamples(test::FiveLayers(), b, i, options.scattering);
    for (int k = 0; k < b.samples; ++k) {
      worst = std::max(worst, std::abs(y[k] - double{b.y[i * b.samples + k]}));
      peak = std::max(peak, y[k]);
    }
  }
  return worst / peak;
}

double DivergenceOfFit(const std::vector<SrdBatch>& batches, const EmOptions& options) {
  std::vector<const SrdBatch*> lights;
  for (const SrdBatch& b : batches) lights.push_back(&b);
  const auto map = FitMixture(lights, {0, 1, 2}, static_cast<int>(batches[0].profiles()), 1, 1, options);
  EXPECT_TRUE(map.ok());
  double sum = 0.0;
  for (float d : map->divergence) sum += d / static_cast<double>(map->divergence.size());
  return sum;
}

TEST(PooledProfiles, ArePredictedAndFittedExactlyAndNotByAGaussian) {
  EmOptions options;
  options.surface_term = options.background_term = false;
  options.max_iterations = 200;
  for (const SampleSites& sites : {SampleSites{2, 0.85, 0.3, 0.2}, SampleSites{4, 0.85, 0.3, 0.0}}) {
    SCOPED_TRACE(sites.pool);
    const std::vector<SrdBatch> exact = PooledProfiles(sites, options);
    std::vector<SrdBatch> gaussian;
    for (const SrdBatch& b : exact) gaussian.push_back(AsGaussian(b));
    for (size_t p = 0; p < exact.size(); ++p) {
      EXPECT_LT(WorstOfPrediction(exact[p], options), 1e-6);
      EXPECT_GT(WorstOfPrediction(gaussian[p], options), 0.02);
    }
    const double of_exact = DivergenceOfFit(exact, options), of_gaussian = DivergenceOfFit(gaussian, options);
    EXPECT_LT(of_exact, 2e-6);
    EXPECT_GT(of_gaussian, 50.0 * of_exact);
  }
}

}  // namespace
}  // namespace stratalux::fit
