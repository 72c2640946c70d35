// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/fit_mixture.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>

#include <gtest/gtest.h>

#include "fitter/mixture/fine_grid.h"
#include "fitter/mixture/line_response.h"
#include "fitter/mixture/shift_law.h"
#include "shared/base/random.h"
#include "tests/fitter/mixture/em_cases.h"

namespace stratalux::fit {
namespace {

// Five layers of skin-like sizes.
LayerSet KnownLayers() {
  return {{0.05, 0.10, 0.12, 0.10, 0.08}, {0.05, 0.2, 0.5, 0.9, 1.4}, {0.2, 0.45, 0.9, 1.8, 3.5}};
}

// Comb geometry of one light on a frontal surface: tan of incidence = slope.
SrdBatch Geometry(double slope, int64_t profiles, double width_mm = 0.58) {
  SrdBatch b;
  b.samples = 64;
  b.wrapped = true;
  b.y.assign(profiles * 64, 0.0F);
  b.noise_floor.assign(profiles, 1e-6F);
  b.noise_slope.assign(profiles, 0.0F);
  b.slope_in.assign(profiles, static_cast<float>(slope));
  for (auto* v : {&b.slope_out, &b.slope_in_across, &b.slope_out_across}) v->assign(profiles, 0.0F);
  b.cos_in.assign(profiles, static_cast<float>(1.0 / std::hypot(1.0, slope)));
  b.cos_out.assign(profiles, 1.0F);
  b.step_mm.assign(profiles, 0.58F);
  b.line_width_mm.assign(profiles, static_cast<float>(width_mm));
  b.blur_mm.assign(profiles, 0.18F);
  b.valid.assign(profiles, 1);
  for (int64_t i = 0; i < profiles; ++i)
    b.first_u_mm.push_back(static_cast<float>(-10.0 + 0.037 * static_cast<double>(i % 40)));
  return b;
}

// Photon noise with `peak_counts` at the brightest sample (0: none).
void FillSamples(SrdBatch& b, const LayerSet& layers, const EmOptions& options, double peak_counts, Random& random) {
  for (int64_t i = 0; i < b.profiles(); ++i) {
    const auto y = PredictSamples(layers, b, i, options.scattering);
    const double counts = peak_counts / *std::max_element(y.begin(), y.end());
    for (int k = 0; k < b.samples; ++k) {
      const double noise = peak_counts > 0.0 ? random.Normal() * std::sqrt(y[k] / counts) : 0.0;
      b.y[i * b.samples + k] = static_cast<float>(y[k] + noise);
    }
    if (!(peak_counts > 0.0)) continue;
    b.noise_floor[i] = static_cast<float>(1e-5 / counts);
    b.noise_slope[i] = static_cast<float>(1.0 / counts);
  }
}

struct Lights {
  std::vector<SrdBatch> batches;
  [[nodiscard]] std::vector<const SrdBatch*> pointers() const {
    std::vector<const SrdBatch*> list;
    for (const SrdBatch& b : batches) list.push_back(&b);
    return list;
  }
};

Lights MakeLights(std::vector<double> slopes, int64_t profiles, double peak_counts, const EmOptions& options,
                  uint64_t seed = 1) {
  Lights lights;
  Random random(seed);
  for (double slope : slopes) {
    lights.batches.push_back(Geometry(slope, profiles));
    FillSamples(lights.batches.back(), KnownLayers(), options, peak_counts, random);
  }
  return lights;
}

Result<MixtureMap> Fit(const Lights& lights, const EmOptions& options) {
  const auto pointers = lights.pointers();
  std::vector<int> projectors(pointers.size());
  for (size_t p = 0; p < projectors.size(); ++p) projectors[p] = static_cast<int>(p);
  return FitMixture(pointers, projectors, static_cast<int>(lights.batches[0].profiles()), 1, 1, options);
}

double Nrmse(const std::vector<double>& truth, const std::vector<double>& estimate) {
  double error = 0.0, power = 0.0;
  for (size_t k = 0; k < truth.size(); ++k) {
    error += (estimate[k] - truth[k]) * (estimate[k] - truth[k]);
    power += truth[k] * truth[k];
  }
  return std::sqrt(error / power);
}

TEST(FitMixture, RecoversTotalDepthAndUnseenLightOfKnownLayersUnderPhotonNoise) {
  EmOptions options;
  options.surface_term = false;
  const Lights lights = MakeLights({-1.0, 0.0, 0.58}, 64, 4000, options);
  const auto map = Fit(lights, options);
  ASSERT_TRUE(map.ok()) << map.status().message();
  const LayerSet known = KnownLayers();
  double known_total = 0.0, known_depth = 0.0;
  for (size_t l = 0; l < known.weight.size(); ++l) {
    known_total += known.weight[l];
    known_depth += known.weight[l] * known.depth_mm[l];
  }
  SrdBatch unseen = Geometry(1.0, 64);
  double total = 0.0, depth = 0.0, error = 0.0;
  for (int64_t i = 0; i < 64; ++i) {
    const LayerSet fitted = LayersOf(*map, i);
    for (size_t l = 0; l < fitted.weight.size(); ++l) {
      total += fitted.weight[l] / 64;
      depth += fitted.weight[l] * fitted.depth_mm[l] / 64;
    }
    error += Nrmse(PredictSamples(known, unseen, i, options.scattering),
                   PredictSamples(fitted, unseen, i, options.scattering)) /
             64;
  }
  EXPECT_NEAR(total / known_total, 1.0, 0.01);
  EXPECT_NEAR(depth / known_depth, 1.0, 0.04);
  EXPECT_LT(error, 0.015);
}

TEST(FitMixture, BeatsTheDirectionBlindFitOnUnseenLightAndFindsPositiveDepth) {
  EmOptions options;
  options.surface_term = false;  // these data have no light from the surface itself
  options.max_iterations = 150;
  const Lights lights = MakeLights({-1.0, 0.0, 0.58}, 16, 0, options);
  EmOptions blind = options;
  blind.direction_blind = true;
  const auto tied = Fit(lights, options), flat = Fit(lights, blind);
  ASSERT_TRUE(tied.ok() && flat.ok());
  const SrdBatch unseen = Geometry(1.0, 16);
  const auto truth = PredictSamples(KnownLayers(), unseen, 3, options.scattering);
  const double with = Nrmse(truth, PredictSamples(LayersOf(*tied, 3), unseen, 3, options.scattering));
  const double without = Nrmse(truth, PredictSamples(LayersOf(*flat, 3), unseen, 3, options.scattering));
  EXPECT_LT(with, 0.3 * without);
  double moment = 0.0;
  const LayerSet layers = LayersOf(*tied, 3);
  for (size_t l = 0; l < layers.weight.size(); ++l) moment += layers.weight[l] * layers.depth_mm[l];
  EXPECT_GT(moment, 0.0) << "a flipped shift coefficient gives negative depths";
}

TEST(FitMixture, DivergenceNeverRisesWithMoreSweeps) {
  EmOptions options;
  options.tolerance = 0.0;
  const Lights lights = MakeLights({-1.0, 0.58}, 16, 4000, options);
  double last = std::numeric_limits<double>::infinity();
  for (int sweeps : {1, 2, 4, 8, 16, 32, 64}) {
    options.max_iterations = sweeps;
    const auto map = Fit(lights, options);
    ASSERT_TRUE(map.ok());
    double sum = 0.0;
    for (float d : map->divergence) sum += d;
    EXPECT_LE(sum, last * (1.0 + 1e-4)) << sweeps;
    last = sum;
  }
}

TEST(FitMixture, WhiteFramesFixTheScaleThatDimSamplesCannot) {
  // Samples with a tenth of the albedo in noise of their sum, white frames with a hundredth.
  EmOptions options;
  options.surface_term = false;
  Lights lights = MakeLights({-0.6, 0.4}, 64, 40, options);
  Random random(3);
  auto spread = [&](const Lights& data) {
    const auto map = Fit(data, options);
    double sum = 0.0, squares = 0.0;
    for (int64_t i = 0; i < 64; ++i) {
      double total = 0.0;
      for (double w : LayersOf(*map, i).weight) total += w;
      sum += total / 64;
      squares += total * total / 64;
    }
    return std::sqrt(squares - sum * sum) / sum;
  };
  const double without = spread(lights);
  for (SrdBatch& b : lights.batches)
    for (int64_t i = 0; i < b.profiles(); ++i) {
      double white = 0.0;
      for (double y : PredictSamples(KnownLayers(), b, i, options.scattering)) white += y;
      b.white.push_back(static_cast<float>(white * (1.0 + 0.01 * random.Normal())));
      b.white_variance.push_back(static_cast<float>(1e-4 * white * white));
    }
  EXPECT_GT(without, 0.04);
  EXPECT_LT(spread(lights), 0.02);
}

TEST(FitMixture, KnowsTheSlitExactly) {
  // Fitted through a line of 1 mm, the layers predict a line of 0.25 mm.
  EmOptions options;
  options.surface_term = false;
  Lights lights;
  Random random(1);
  for (double slope : {-1.0, 0.0, 0.58}) {
    lights.batches.push_back(Geometry(slope, 16, 1.16));
    FillSamples(lights.batches.back(), KnownLayers(), options, 0, random);
  }
  options.max_iterations = 200;
  const auto map = Fit(lights, options);
  ASSERT_TRUE(map.ok());
  const SrdBatch narrow = Geometry(0.3, 16, 0.25);
  EXPECT_LT(Nrmse(PredictSamples(KnownLayers(), narrow, 5, options.scattering),
                  PredictSamples(LayersOf(*map, 5), narrow, 5, options.scattering)),
            0.03);
}

TEST(FitMixture, ModelledLightAddsUpToTheMeasured) {
  EmOptions options;
  const Lights lights = MakeLights({0.0, 0.58}, 16, 0, options);
  const auto map = Fit(lights, options);
  ASSERT_TRUE(map.ok());
  for (size_t p = 0; p < 2; ++p) {
    const auto y = PredictSamples(LayersOf(*map, 2), lights.batches[p], 2, options.scattering);
    double modelled = 64.0 * map->background[2 * 2 + p] + map->surface[2 * 2 + p], measured = 0.0;
    for (int k = 0; k < 64; ++k) {
      modelled += y[k];
      measured += lights.batches[p].y[2 * 64 + k];
    }
    EXPECT_NEAR(modelled / measured, 1.0, 2e-3);
  }
}

TEST(FitMixture, IsBitIdenticalForAnyNumberOfThreads) {
  EmOptions options;
  options.max_iterations = 12;
  const Lights lights = MakeLights({-0.6, 0.4}, 100, 2000, options);
  setenv("STRATALUX_THREADS", "1", 1);
  const auto one = Fit(lights, options);
  setenv("STRATALUX_THREADS", "3", 1);
  const auto three = Fit(lights, options);
  unsetenv("STRATALUX_THREADS");
  ASSERT_TRUE(one.ok() && three.ok());
  EXPECT_EQ(one->weight, three->weight);
  EXPECT_EQ(one->depth_mm, three->depth_mm);
  EXPECT_EQ(one->sigma_mm, three->sigma_mm);
}

TEST(FitMixture, CountsBadProfilesAndNeverReturnsNaN) {
  EmOptions options;
  Lights lights = MakeLights({-0.6, 0.4}, 16, 2000, options);
  auto set_all = [&](int64_t profile, float value) {
    for (SrdBatch& b : lights.batches) std::fill_n(b.y.begin() + profile * 64, 64, value);
  };
  set_all(0, std::numeric_limits<float>::quiet_NaN());
  set_all(1, 0.25F);  // constant
  set_all(2, 0.0F);
  set_all(3, -1.0F);
  for (SrdBatch& b : lights.batches) b.valid[4] = 0;
  lights.batches[0].valid[5] = 0;                                                      // one light only
  for (SrdBatch& b : lights.batches) b.y[6 * 64 + 10] = -0.01F;                        // a negative sample is data
  for (SrdBatch& b : lights.batches) std::fill_n(b.y.begin() + 7 * 64 + 1, 63, 0.0F);  // a single lit sample
  for (SrdBatch& b : lights.batches) b.slope_in[8] = 0.0F;
  const auto map = Fit(lights, options);
  ASSERT_TRUE(map.ok());
  for (const auto* v :
       {&map->weight, &map->depth_mm, &map->sigma_mm, &map->surface, &map->background, &map->divergence})
    for (float x : *v) ASSERT_TRUE(std::isfinite(x));
  // Without the rows of what is not valid, nothing else is seen.
  for (SrdBatch& b : lights.batches) b.KeepValidRows();
  const auto compact = Fit(lights, options);
  ASSERT_TRUE(compact.ok());
  EXPECT_EQ(compact->weight, map->weight);
  EXPECT_EQ(compact->depth_mm, map->depth_mm);
  EXPECT_EQ(compact->surface, map->surface);
  EXPECT_EQ(compact->reason, map->reason);
  auto reason = [&](int64_t i) { return static_cast<FitReason>(map->reason[i]); };
  EXPECT_EQ(reason(0), FitReason::kNotFinite);
  EXPECT_EQ(reason(1), FitReason::kTooDark);
  EXPECT_EQ(reason(2), FitReason::kTooDark);
  EXPECT_EQ(reason(3), FitReason::kTooDark);
  EXPECT_EQ(reason(4), FitReason::kNoProjector);
  EXPECT_EQ(reason(5), FitReason::kFitted);
  EXPECT_EQ(reason(6), FitReason::kFitted);
  EXPECT_EQ(reason(8), FitReason::kDepthNotEstimable);
  EXPECT_EQ(map->weight[0], 0.0F);
}

// Numbers of every kind in every field: whatever comes, the map is finite and each profile has its reason.
TEST(FitMixture, SurvivesAnyNumbers) {
  constexpr float kInf = std::numeric_limits<float>::infinity();
  constexpr float kOdd[] = {
      0.0F,  -0.0F,  1e-30F, -1e-3F, 1.0F,   50.0F, 1e6F,  -1e6F,
      1e30F, -1e30F, 1e-7F,  3e38F,  1e-44F, kInf,  -kInf, std::numeric_limits<float>::quiet_NaN()};
  Random random(31);
  for (bool wrapped : {true, false}) {
    EmOptions options;
    options.max_iterations = 10;
    Lights lights = MakeLights({-0.6, 0.4}, 300, 2000, options);
    for (SrdBatch& b : lights.batches) {
      b.wrapped = wrapped;
      b.white.assign(300, 0.5F);
      b.white_variance.assign(300, 1e-4F);
      b.pool = 2;
      b.quad_x_mm.assign(300, 0.4F);
      b.pair_mm.assign(300, 0.2F);
      auto* const fields = &b;
      for (auto* values : {&fields->y, &fields->noise_floor, &fields->noise_slope, &fields->white,
                           &fields->white_variance, &fields->first_u_mm, &fields->line_width_mm, &fields->blur_mm,
                           &fields->quad_x_mm, &fields->pair_mm, &fields->slope_in, &fields->slope_out, &fields->cos_in,
                           &fields->slope_in_across, &fields->slope_out_across})
        for (int n = 0; n < 40; ++n)
          (*values)[static_cast<size_t>(random.Uniform() * static_cast<double>(values->size()))] =
              kOdd[static_cast<size_t>(random.Uniform() * std::size(kOdd))];
      for (float step : {kInf, -0.5F, 0.0F, 1e5F, 1e-5F}) b.step_mm[static_cast<size_t>(random.Uniform() * 300)] = step;
    }
    const auto map = Fit(lights, options);
    ASSERT_TRUE(map.ok());
    for (const auto* v :
         {&map->weight, &map->depth_mm, &map->sigma_mm, &map->surface, &map->background, &map->divergence})
      for (size_t i = 0; i < v->size(); ++i) ASSERT_TRUE(std::isfinite((*v)[i])) << i * 300 / v->size();
    int fitted = 0;
    for (uint8_t reason : map->reason) {
      ASSERT_LT(reason, kFitReasons);
      fitted += static_cast<FitReason>(reason) == FitReason::kFitted ? 1 : 0;
    }
    EXPECT_GT(fitted, 50);
  }
}

TEST(FitMixture, HoldsWidthsToTheGridAndFitsWhatSaturatedAsItIs) {
  EmOptions options;
  options.min_sigma_mm = 1e-4;
  Lights lights = MakeLights({-0.6, 0.4}, 2, 0, options);
  for (SrdBatch& b : lights.batches)  // the second profile saturated at half its peak
    for (int k = 0; k < 64; ++k) b.y[64 + k] = std::min(b.y[64 + k], 0.5F * *std::max_element(b.y.begin(), b.y.end()));
  const auto map = Fit(lights, options);
  ASSERT_TRUE(map.ok());
  for (float sigma : map->sigma_mm) EXPECT_GE(sigma, 0.9F * 0.58F / 4 * 0.999F);
  EXPECT_TRUE(map->Fitted(1));
  EXPECT_GT(map->divergence[1], map->divergence[0]);
}

// A camera of few pixels sees lines of millimetres through a blur of millimetres: cells as fine as a quarter of that
// serve as well as cells of a tenth of a millimetre, and coarser ones do not.
TEST(FitMixture, CellsNeedNotBeFinerThanTheBlur) {
  const EmCaseOptions camera = {.profiles = 64, .samples = 16, .coarse = 8.0, .peak_counts = 2e4};
  EmOptions options, fine, coarse;
  fine.cells_per_sample = 48;
  coarse.max_cell_mm = 2.0;
  const EmCases made = MakeEmCases(camera, options, 61);
  const auto error = [&](const EmOptions& of) {
    const auto map = FitMixture(made.lights(), {0, 1, 2}, camera.profiles, 1, 1, of);
    EXPECT_TRUE(map.ok());
    return ShapeError(made, *map, of, 1, camera);
  };
  const auto cells = [&](const EmOptions& of) {
    return CellsPerSample(made.batches[0], 0, made.batches[0].blur_mm[0], of);
  };
  const double as_blurred = error(options), finer = error(fine), coarser = error(coarse);
  std::printf("error of the shape of unseen light: %.5f, with finer cells %.5f, with coarser ones %.5f\n", as_blurred,
              finer, coarser);
  EXPECT_LT(cells(options), cells(fine) / 2);
  EXPECT_LT(as_blurred, 1.05 * finer);
  EXPECT_GT(coarser, 1.2 * finer);
}

TEST(FitMixture, RefusesOptionsOutOfRange) {
  EmOptions options;
  const Lights lights = MakeLights({0.0}, 16, 0, options);
  options.layers = 33;
  EXPECT_EQ(Fit(lights, options).status().code(), StatusCode::kUsage);
  options = {};
  options.scattering.eta = 0.5;
  EXPECT_EQ(Fit(lights, options).status().code(), StatusCode::kUsage);
}

TEST(EstimateTau, FindsTheObliquePathOfTheTrainingLights) {
  EmOptions options;
  options.scattering.tau = 0.35;
  const Lights lights = MakeLights({-1.2, 0.0, 0.7}, 64, 4000, options);
  EXPECT_NEAR(EstimateTau(lights.pointers(), options.scattering.eta), 0.35, 0.03);
}

TEST(ShiftLaw, FollowsSnellAndKeepsTheDirection) {
  const double tan45 = 1.0, sin_t = std::sin(M_PI / 4) / 1.4;
  EXPECT_DOUBLE_EQ(TangentialShift(ShiftLaw::kPaper, tan45, 0, 1.4), 1.0);
  EXPECT_NEAR(TangentialShift(ShiftLaw::kRefractedSine, tan45, 0, 1.4), sin_t, 1e-12);
  EXPECT_NEAR(TangentialShift(ShiftLaw::kRefracted, -tan45, 0, 1.4), -std::tan(std::asin(sin_t)), 1e-12);
  EXPECT_NEAR(
      TangentialShift(ShiftLaw::kRefracted, 0.6, 0.8, 1.4) / TangentialShift(ShiftLaw::kRefracted, 1.0, 0.0, 1.4), 0.6,
      1e-12);
}

TEST(LineResponse, IsTheDifferenceOfNormalDistributionsAveragedOverTheCell) {
  const LineResponse b{0.58, 0.2, 0.0, 0.145};
  auto phi = [](double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); };
  for (double t : {0.0, 0.2, 0.5, 0.9}) {
    double mean = 0.0;
    for (int i = 0; i < 200; ++i) {
      const double x = t + 0.145 * ((i + 0.5) / 200 - 0.5);
      mean += (phi((x + 0.29) / 0.2) - phi((x - 0.29) / 0.2)) / 200;
    }
    EXPECT_NEAR(b.At(t), mean, 1e-6);
  }
  double sum = 0.0;  // coverage: the samples of a cycle see every cell once
  for (int k = -20; k <= 20; ++k) sum += b.At(0.07 + 0.58 * k);
  EXPECT_NEAR(sum, 1.0, 1e-9);
}

// The light of the surface itself added to that of known layers.
TEST(FitMixture, SurfaceReflectionTakesTheSurfacesLightOffTheLayers) {
  EmOptions options;
  options.scattering.gain_model = false;
  options.scattering.reflection = {1.2, 0.35};
  Lights lights = MakeLights({-1.0, 0.0, 0.577}, 8, 0.0, options);
  for (SrdBatch& b : lights.batches)
    for (int64_t i = 0; i < b.profiles(); ++i) {
      const LayerSet surface = {
          {ReflectanceOf(options.scattering.reflection, ReflectionAngles::Of(b, i), options.scattering.eta)},
          {0.0},
          {1e-3}};
      const auto y = PredictSamples(surface, b, i, options.scattering);
      for (int k = 0; k < b.samples; ++k) b.y[i * b.samples + k] += static_cast<float>(y[k]);
    }
  const auto error_of_total = [&](const EmOptions& of) {
    const auto map = Fit(lights, of);
    EXPECT_TRUE(map.ok());
    double worst = 0.0;
    for (int64_t i = 0; i < map->profiles(); ++i) {
      double total = 0.0, truth = 0.0;
      for (double w : LayersOf(*map, i).weight) total += w;
      for (double w : KnownLayers().weight) truth += w;
      worst = std::max(worst, std::abs(total / truth - 1.0));
    }
    return worst;
  };
  EXPECT_LT(error_of_total(options), 0.01);
  // White frames that say otherwise move the layers, not the surface that is held.
  for (SrdBatch& b : lights.batches)
    for (int64_t i = 0; i < b.profiles(); ++i) {
      const double surface =
          ReflectanceOf(options.scattering.reflection, ReflectionAngles::Of(b, i), options.scattering.eta);
      b.white.push_back(static_cast<float>((WhiteReflectanceOf(b, i).value - surface) * 1.2 + surface));
      b.white_variance.push_back(1e-12F);
    }
  const auto brighter = Fit(lights, options);
  ASSERT_TRUE(brighter.ok());
  EXPECT_NEAR(
      brighter->surface[0],
      ReflectanceOf(options.scattering.reflection, ReflectionAngles::Of(lights.batches[0], 0), options.scattering.eta),
      1e-6);
  double total = 0.0;
  for (double w : LayersOf(*brighter, 0).weight) total += w;
  EXPECT_NEAR(total, 1.2 * 0.45, 0.01);
  for (SrdBatch& b : lights.batches) b.white.clear();
  EmOptions unknown = options;
  unknown.scattering.reflection = {};
  EXPECT_GT(error_of_total(unknown), 0.03);
}

// Dark skin: of the light near the mirror four fifths are the surface's, more than all of a mean light.
TEST(FitMixture, ALightNearTheMirrorKeepsItsSurfacesLight) {
  constexpr float kDark = 0.04F;
  EmOptions options;
  options.scattering.gain_model = false;
  options.scattering.reflection = {1.2, 0.35};
  Lights lights = MakeLights({-1.0, 0.0, 0.577}, 8, 0.0, options);
  std::vector<double> share;
  for (SrdBatch& b : lights.batches)
    for (int64_t i = 0; i < b.profiles(); ++i) {
      const double reflected =
          ReflectanceOf(options.scattering.reflection, ReflectionAngles::Of(b, i), options.scattering.eta);
      const auto y = PredictSamples({{reflected}, {0.0}, {1e-3}}, b, i, options.scattering);
      for (int k = 0; k < b.samples; ++k) {
        float& sample = b.y[i * b.samples + k];
        sample = kDark * sample + static_cast<float>(y[k]);
      }
      if (i == 0) share.push_back(reflected / WhiteReflectanceOf(b, 0).value);
    }
  ASSERT_GT(*std::max_element(share.begin(), share.end()), 0.75);
  ASSERT_LT(*std::min_element(share.begin(), share.end()), 0.6);
  const auto map = Fit(lights, options);
  ASSERT_TRUE(map.ok());
  for (int64_t i = 0; i < map->profiles(); ++i) {
    double total = 0.0, truth = 0.0;
    for (double w : LayersOf(*map, i).weight) total += w;
    for (double w : KnownLayers().weight) truth += kDark * w;
    EXPECT_NEAR(total / truth, 1.0, 0.05) << i;
  }
  // What the surface is held at is never more than nearly all of what the light shows.
  EmOptions glossy = options;
  glossy.scattering.reflection = {3.0, 0.35};
  for (SrdBatch& b : lights.batches)  // white frames a tenth above the samples' sums
    for (int64_t i = 0; i < b.profiles(); ++i) {
      b.white.push_back(static_cast<float>(1.1 * WhiteReflectanceOf(b, i).value));
      b.white_variance.push_back(1e-6F);
    }
  const auto held = Fit(lights, glossy);
  ASSERT_TRUE(held.ok());
  for (size_t p = 0; p < lights.batches.size(); ++p)
    EXPECT_LE(held->surface[p], kMostSurface * WhiteReflectanceOf(lights.batches[p], 0).value + 1e-6);
  for (int64_t i = 0; i < held->profiles(); ++i) {
    double total = 0.0;
    for (double w : LayersOf(*held, i).weight) total += w;
    EXPECT_TRUE(std::isfinite(total) && total > 0.0) << i;
  }
}

}  // namespace
}  // namespace stratalux::fit
