// SPDX-License-Identifier: Apache-2.0
#include "fitter/profiles/profile_model.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/table_tool/line_spread.h"
#include "shared/base/random.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;

double Phi(double x) { return 0.5 * std::erfc(-x / std::numbers::sqrt2); }

// Snell, written out here independently of the fitter.
double Refracted(double degrees) {
  const double sine = std::sin(degrees * std::numbers::pi / 180.0) / 1.4;
  return sine;  // of a step along the ray: the default law
}

struct Layer {
  double depth, sigma, weight;
};
const std::vector<Layer> kSkin = {
    {0.05, 0.15, 0.05}, {0.2, 0.4, 0.12}, {0.5, 0.9, 0.15}, {0.9, 1.8, 0.10}, {1.4, 3.0, 0.06}};

// The formula of docs/profiles.md by brute force: the mean over the step from 40 points.
LineProfile Ideal(const std::string& name, double incidence, double exit, double slit, double step = 0.25,
                  double background = 0.001) {
  LineProfile p;
  p.source = name;
  p.incidence_deg = incidence;
  p.exit_deg = exit;
  p.slit_mm = slit;
  p.step_mm = step;
  p.first_u_mm = -14.0;
  p.samples = static_cast<int>(28.0 / step) + 1;
  const double s = Refracted(incidence) + Refracted(exit);
  for (int k = 0; k < p.samples; ++k) {
    double sum = 0.0;
    for (int j = 0; j < 40; ++j) {
      const double u = p.first_u_mm + (k + (j + 0.5) / 40.0 - 0.5) * step;
      for (const Layer& l : kSkin)
        sum += l.weight / 40.0 *
               (Phi((u + slit / 2 - l.depth * s) / l.sigma) - Phi((u - slit / 2 - l.depth * s) / l.sigma));
    }
    p.radiance.push_back(background + sum);
  }
  return p;
}

double Nrmse(const std::vector<double>& truth, const std::vector<double>& estimate) {
  double error = 0.0, power = 0.0;
  for (size_t k = 0; k < truth.size(); ++k) {
    error += std::pow(estimate[k] - truth[k], 2);
    power += truth[k] * truth[k];
  }
  return std::sqrt(error / power);
}

EmOptions WithoutGain() {
  EmOptions options = ProfileOptions();
  options.scattering.gain_model = false;
  return options;
}

std::vector<LineProfile> Training() {
  return {Ideal("a", -45, 0, 0.5), Ideal("b", 0, 0, 1.0), Ideal("c", 30, 0, 0.25, 0.1)};
}

TEST(ProfileModel, FindsTheAlbedoTheDepthAndTheFloorOfKnownLayers) {
  const auto model = FitProfiles(Training(), WithoutGain());
  ASSERT_TRUE(model.ok()) << model.status().message();
  double weight = 0.0, depth = 0.0, known_weight = 0.0, known_depth = 0.0;
  for (size_t l = 0; l < model->layers.weight.size(); ++l) {
    weight += model->layers.weight[l];
    depth += model->layers.weight[l] * model->layers.depth_mm[l];
  }
  for (const Layer& l : kSkin) {
    known_weight += l.weight;
    known_depth += l.weight * l.depth;
  }
  EXPECT_NEAR(weight / known_weight, 1.0, 0.01);
  EXPECT_NEAR(depth / known_depth, 1.0, 0.04);
  EXPECT_NEAR(model->background, 0.001, 3e-4);
  for (const SourceFit& s : model->sources) EXPECT_LT(s.nrmse, 0.015) << s.source;
}

TEST(ProfileModel, PredictsUnseenIncidenceExitSlitAndStep) {
  const auto model = FitProfiles(Training(), WithoutGain());
  ASSERT_TRUE(model.ok());
  EmOptions blind = WithoutGain();
  blind.direction_blind = true;
  const auto flat = FitProfiles(Training(), blind);
  ASSERT_TRUE(flat.ok());
  for (const LineProfile& unseen :
       {Ideal("x", 45, 0, 0.5), Ideal("y", 60, 30, 0.3, 0.2), Ideal("z", -20, -30, 1.5, 0.5)}) {
    const auto predicted = PredictProfile(*model, unseen), without = PredictProfile(*flat, unseen);
    ASSERT_TRUE(predicted.ok() && without.ok());
    EXPECT_LT(Nrmse(unseen.radiance, *predicted), 0.02) << unseen.source;
    EXPECT_GT(Nrmse(unseen.radiance, *without), 4.0 * Nrmse(unseen.radiance, *predicted)) << unseen.source;
  }
}

TEST(ProfileModel, TurnsWithTheLightNotAgainstIt) {
  // Light that travels towards +u carries the profile towards +u.
  const auto model = FitProfiles(Training(), WithoutGain());
  ASSERT_TRUE(model.ok());
  auto centroid = [&](double incidence, double exit) {
    const LineProfile p = Ideal("x", incidence, exit, 0.5);
    const auto y = PredictProfile(*model, p);
    double sum = 0.0, moment = 0.0;
    for (int k = 0; k < p.samples; ++k) {
      sum += (*y)[k] - model->background;
      moment += ((*y)[k] - model->background) * (p.first_u_mm + k * p.step_mm);
    }
    return moment / sum;
  };
  EXPECT_GT(centroid(45, 0), 0.1);
  EXPECT_GT(centroid(0, 45), 0.1);
  EXPECT_NEAR(centroid(45, -45), 0.0, 1e-3);
  EXPECT_NEAR(centroid(-45, 0), -centroid(45, 0), 1e-3);
}

TEST(ProfileModel, SurvivesPhotonNoiseAndNegativeSamples) {
  auto profiles = Training();
  Random random(7);
  for (LineProfile& p : profiles)
    for (double& y : p.radiance) y += random.Normal() * std::sqrt(y * 2e-5 + 1e-6) - 0.001;  // floor removed: negatives
  const auto model = FitProfiles(profiles, WithoutGain());
  ASSERT_TRUE(model.ok()) << model.status().message();
  const LineProfile unseen = Ideal("x", 45, 0, 0.5, 0.25, 0.0);
  const auto predicted = PredictProfile(*model, unseen);
  ASSERT_TRUE(predicted.ok());
  EXPECT_LT(Nrmse(unseen.radiance, *predicted), 0.05);
  for (double w : model->layers.weight) EXPECT_TRUE(std::isfinite(w) && w >= 0.0);
}

TEST(ProfileModel, FindsTheAngularGain) {
  // Fresnel and a path of optical depth 0.3 through the epidermis, written out here.
  auto gain = [](double degrees) {
    const double ci = std::cos(degrees * std::numbers::pi / 180.0), st = std::sqrt(1 - ci * ci) / 1.4,
                 ct = std::sqrt(1 - st * st);
    auto fresnel = [](double a, double b) {
      const double s = (a - 1.4 * b) / (a + 1.4 * b), p = (1.4 * a - b) / (1.4 * a + b);
      return 1.0 - 0.5 * (s * s + p * p);
    };
    return fresnel(ci, ct) / fresnel(1, 1) * std::exp(-0.3 * (1.0 / ct - 1.0));
  };
  std::vector<LineProfile> profiles = {Ideal("a", -60, 0, 0.5, 0.25, 0), Ideal("b", 0, 0, 0.5, 0.25, 0),
                                       Ideal("c", 30, 0, 0.5, 0.25, 0)};
  for (LineProfile& p : profiles)
    for (double& y : p.radiance) y *= gain(p.incidence_deg);
  const auto model = FitProfiles(profiles, ProfileOptions());
  ASSERT_TRUE(model.ok());
  EXPECT_NEAR(model->scattering.tau, 0.3, 0.05);
}

TEST(ProfileModel, FreeModeKnowsItsOwnSourcesOnly) {
  EmOptions options = WithoutGain();
  options.scattering.mode = FitMode::kFree;
  const auto model = FitProfiles(Training(), options);
  ASSERT_TRUE(model.ok());
  for (const LineProfile& p : Training()) {
    const auto own = PredictProfile(*model, p);
    ASSERT_TRUE(own.ok());
    EXPECT_LT(Nrmse(p.radiance, *own), 0.01);
  }
  const auto unknown = PredictProfile(*model, Ideal("x", 45, 0, 0.5));
  ASSERT_FALSE(unknown.ok());
  EXPECT_EQ(unknown.status().code(), StatusCode::kUsage);
  EXPECT_THAT(unknown.status().message(), HasSubstr("'x'"));
}

TEST(ProfileModel, JsonKeepsWhatPredictionNeeds) {
  for (FitMode mode : {FitMode::kTied, FitMode::kFree}) {
    EmOptions options = ProfileOptions();
    options.scattering.mode = mode;
    const auto model = FitProfiles(Training(), options);
    ASSERT_TRUE(model.ok());
    const auto read = ProfileModel::FromJson(model->ToJson(), "m.json");
    ASSERT_TRUE(read.ok()) << read.status().message();
    const auto profile = Ideal("a", -45, 0, 0.5);
    EXPECT_LT(Nrmse(*PredictProfile(*model, profile), *PredictProfile(*read, profile)), 1e-9);
  }
  for (const char* text : {"", "{", "{}", R"({"schema":2,"mode":"tied"})", R"({"schema":2,"mode":"x","gain":"none"})",
                           R"({"schema":1})"}) {
    const auto read = ProfileModel::FromJson(text, "m.json");
    ASSERT_FALSE(read.ok()) << text;
    EXPECT_EQ(read.status().code(), StatusCode::kUsage);
    EXPECT_THAT(read.status().message(), HasSubstr("m.json"));
  }
  EXPECT_EQ(ProfileModel::FromJson(R"({"schema":3})", "m.json").status().code(), StatusCode::kNewerSchema);
}

TEST(ProfileModel, RefusesSourcesWithoutLightAndSaysWhenDepthMeansNothing) {
  LineProfile dark = Ideal("dark", 0, 0, 0.5);
  for (double& y : dark.radiance) y = 0.0;
  EXPECT_THAT(FitProfiles({dark}, ProfileOptions()).status().message(), HasSubstr("'dark' carries no light"));
  EXPECT_FALSE(FitProfiles({}, ProfileOptions()).ok());
  const auto frontal = FitProfiles({Ideal("a", 0, 0, 0.5)}, WithoutGain());
  ASSERT_TRUE(frontal.ok());
  EXPECT_FALSE(frontal->depth_estimable);
  EXPECT_THAT(frontal->warnings, ::testing::Contains(HasSubstr("oblique")));
  const auto all = FitProfiles(Training(), WithoutGain());
  ASSERT_TRUE(all.ok());
  EXPECT_TRUE(all->depth_estimable);
  EXPECT_THAT(all->warnings, ::testing::IsEmpty());
}

TEST(ProfileModel, RefusesConstantsAndWarnsOfPlateausAndNarrowWindows) {
  LineProfile flat = Ideal("flat", 0, 0, 0.5);
  for (double& y : flat.radiance) y = 0.2;
  EXPECT_THAT(FitProfiles({flat}, ProfileOptions()).status().message(), HasSubstr("'flat' has the same radiance"));

  for (double scale : {1e-20, 1e300}) {
    LineProfile absurd = Ideal("absurd", 0, 0, 0.5);
    for (double& y : absurd.radiance) y *= scale;
    EXPECT_THAT(FitProfiles({absurd}, ProfileOptions()).status().message(), HasSubstr("1 is a white target"));
  }

  LineProfile saturated = Ideal("saturated", 30, 0, 0.5, 0.1);
  const double ceiling = 0.5 * *std::max_element(saturated.radiance.begin(), saturated.radiance.end());
  for (double& y : saturated.radiance) y = std::min(y, ceiling);
  const auto clipped = FitProfiles({saturated}, ProfileOptions());
  ASSERT_TRUE(clipped.ok());
  EXPECT_THAT(clipped->warnings, ::testing::Contains(HasSubstr("saturated")));

  LineProfile narrow = Ideal("narrow", 30, 0, 0.5, 0.1);
  narrow.radiance.erase(narrow.radiance.begin(), narrow.radiance.begin() + 135);
  narrow.radiance.resize(11);
  narrow.first_u_mm += 13.5;
  narrow.samples = 11;
  const auto cut = FitProfiles({narrow}, ProfileOptions());
  ASSERT_TRUE(cut.ok());
  EXPECT_THAT(cut->warnings, ::testing::Contains(HasSubstr("window is too narrow")));
  for (double w : cut->layers.weight) EXPECT_TRUE(std::isfinite(w));
}

TEST(ProfileModel, LayersThatKnowNoDirectionGetNoDirectionalWeights) {
  // ... and say with which errors their albedo and depth are known.
  auto profiles = Training();
  Random random(3);
  for (LineProfile& p : profiles) {
    const double peak = *std::max_element(p.radiance.begin(), p.radiance.end());
    for (double& y : p.radiance) y += random.Normal() * std::sqrt(y * peak / 4000.0);
  }
  const auto model = FitProfiles(profiles, WithoutGain());
  ASSERT_TRUE(model.ok());
  EXPECT_TRUE(model->scattering.directional.Off());
  ASSERT_TRUE(model->effective.has_value());
  double weight = 0.0, depth = 0.0;
  for (const Layer& l : kSkin) {
    weight += l.weight;
    depth += l.weight * l.depth;
  }
  const EffectiveParameters& e = *model->effective;
  EXPECT_NEAR(e.total_weight.value / weight, 1.0, 0.01);
  EXPECT_NEAR(e.mean_depth_mm.value / (depth / weight), 1.0, 0.04);
  EXPECT_LT(std::abs(e.mean_depth_mm.value - depth / weight), 4.0 * e.mean_depth_mm.standard_error);
  EXPECT_LT(e.mean_depth_mm.standard_error, 0.04 * depth / weight);
}

// Light that scattered once in a half-space (its integral over the depth, no Gaussians; Henyey-Greenstein of asymmetry
// 0.8) beside the known layers: what narrow light really does with the directions.
LineProfile WithSingleScattering(double incidence, double exit) {
  LineProfile p = Ideal("i" + std::to_string(incidence) + " e" + std::to_string(exit), incidence, exit, 0.5, 0.1, 0.0);
  constexpr double kMu = 8.0, kG = 0.8, kAlbedo = 0.06;
  const double in = std::asin(Refracted(incidence)), out = std::asin(Refracted(exit));
  const double phase = std::pow((1 + kG) * (1 + kG) / (1 + kG * kG + 2 * kG * std::cos(in + out)), 1.5);
  const double sec_in = 1.0 / std::cos(in), sec_out = 1.0 / std::cos(out);
  for (int k = 0; k < p.samples; ++k)
    for (int j = 0; j < 400; ++j) {
      const double dz = 2e-3, z = (j + 0.5) * dz;
      const double share =
          kAlbedo * 2.0 * kMu * dz * sec_in * sec_out * phase * std::exp(-kMu * z * (sec_in + sec_out));
      const double low = p.first_u_mm + (k - 0.5) * p.step_mm - z * (std::tan(in) + std::tan(out)),
                   high = low + p.step_mm;
      p.radiance[k] += share * std::max(0.0, std::min(high, 0.25) - std::max(low, -0.25)) / p.step_mm;
    }
  return p;
}

TEST(ProfileModel, DirectionalWeightsPredictSingleScatteringAtUnseenAngles) {
  std::vector<LineProfile> profiles;
  for (double exit : {-30.0, 0.0})
    for (double incidence : {-45.0, 0.0, 30.0}) profiles.push_back(WithSingleScattering(incidence, exit));
  EmOptions options = WithoutGain();
  options.max_iterations = 60;
  const auto with = FitProfiles(profiles, options), without = FitProfiles(profiles, options, Directional::kOff);
  ASSERT_TRUE(with.ok() && without.ok());
  EXPECT_FALSE(with->scattering.directional.Off());
  for (const LineProfile& unseen : {WithSingleScattering(45, 30), WithSingleScattering(60, 0)}) {
    const double error = Nrmse(unseen.radiance, *PredictProfile(*with, unseen));
    EXPECT_LT(error, 0.04) << unseen.source;
    EXPECT_LT(error, 0.8 * Nrmse(unseen.radiance, *PredictProfile(*without, unseen))) << unseen.source;
  }
}

TEST(ProfileModel, PredictsMonteCarloSkinFromUnseenLight) {
  const ScratchFolder scratch;
  // The independent judge: photons through layered skin, no Gaussians, few enough for a test.
  rig::LineSpreadOptions options;
  options.channel = 0;
  options.photons = 250000;
  options.slit_mm = {1.0};
  const auto& folder = scratch.path();
  auto read = [&](const char* name) {
    std::ofstream(folder / name) << rig::LineSpreadCsv(options);
    return ReadProfiles((folder / name).string(), true);
  };
  const auto training = read("train.csv");
  options.incidence_deg = {45};
  options.seed = 2;
  const auto unseen = read("unseen.csv");
  ASSERT_TRUE(training.ok() && unseen.ok());
  EmOptions blind = ProfileOptions();
  blind.direction_blind = true;
  const auto model = FitProfiles(training->profiles, ProfileOptions()), flat = FitProfiles(training->profiles, blind);
  ASSERT_TRUE(model.ok() && flat.ok());
  const auto& truth = unseen->profiles[0];
  const double with = Nrmse(truth.radiance, *PredictProfile(*model, truth)),
               without = Nrmse(truth.radiance, *PredictProfile(*flat, truth));
  EXPECT_LT(with, 0.06);  // photon noise of both runs included
  EXPECT_LT(with, 0.5 * without);
}

}  // namespace
}  // namespace stratalux::fit
