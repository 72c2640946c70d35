// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/mixture/em_cases.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "fitter/mixture/fit_mixture.h"

namespace stratalux::fit {
namespace {

LayerSet RandomSkin(Random& random) {
  LayerSet skin;
  const int layers = 3 + static_cast<int>(random.Uniform() * 4.999);
  for (int l = 0; l < layers; ++l) {
    const double sigma = 0.15 * std::pow(4.0 / 0.15, random.Uniform());
    skin.sigma_mm.push_back(sigma);
    skin.depth_mm.push_back(random.Uniform(0.02, std::min(2.0, 0.6 * sigma + 0.1)));
    skin.weight.push_back(random.Uniform(0.02, 0.15));
  }
  return skin;
}

LayerSet Varied(LayerSet skin, double most, Random& random) {
  for (auto* values : {&skin.weight, &skin.depth_mm, &skin.sigma_mm})
    for (double& v : *values) v *= random.Uniform(1.0 - most, 1.0 + most);
  return skin;
}

// Every profile's own step, blur and offset; the lights of a profile share nothing but the skin.
SrdBatch GeometryOf(const EmCaseOptions& cases, double slope, Random& random) {
  SrdBatch b;
  b.samples = cases.samples;
  b.wrapped = cases.wrapped;
  b.pool = cases.pool;
  const auto n = static_cast<size_t>(cases.profiles);
  b.y.assign(n * b.samples, 0.0F);
  b.noise_floor.assign(n, 1e-6F);
  b.noise_slope.assign(n, 0.0F);
  b.valid.assign(n, 1);
  for (auto* v : {&b.slope_in_across, &b.slope_out_across}) v->assign(n, 0.0F);
  for (size_t i = 0; i < n; ++i) {
    const double step = cases.coarse * random.Uniform(0.45, 0.59), in = slope + random.Uniform(-0.1, 0.1),
                 out = random.Uniform(-0.3, 0.3);
    b.step_mm.push_back(static_cast<float>(step));
    b.line_width_mm.push_back(static_cast<float>(step));
    b.blur_mm.push_back(static_cast<float>(cases.coarse * random.Uniform(0.1, 0.25)));
    b.first_u_mm.push_back(static_cast<float>(-0.5 * step * (b.samples - 1) + random.Uniform(-0.5, 0.5)));
    b.slope_in.push_back(static_cast<float>(in));
    b.slope_out.push_back(static_cast<float>(out));
    b.cos_in.push_back(static_cast<float>(1.0 / std::hypot(1.0, in)));
    b.cos_out.push_back(static_cast<float>(1.0 / std::hypot(1.0, out)));
    if (b.pool == 1) continue;
    b.quad_x_mm.push_back(static_cast<float>(random.Uniform(-0.9, 0.9)));
    b.quad_y_mm.push_back(static_cast<float>(random.Uniform(-0.4, 0.4)));
    b.pair_mm.push_back(static_cast<float>(random.Uniform(0.0, 0.3)));
  }
  return b;
}

}  // namespace

std::vector<const SrdBatch*> EmCases::lights() const {
  std::vector<const SrdBatch*> list;
  for (const SrdBatch& b : batches) list.push_back(&b);
  return list;
}

EmCases MakeEmCases(const EmCaseOptions& cases, const EmOptions& options, uint64_t seed) {
  Random random(seed);
  EmCases made;
  LayerSet skin;
  for (int i = 0; i < cases.profiles; ++i) {
    const auto number = static_cast<size_t>(i / cases.alike);
    if (i % cases.alike == 0)
      skin = cases.skins.empty() ? RandomSkin(random) : cases.skins[number % cases.skins.size()];
    made.skins.push_back(cases.alike > 1 ? Varied(skin, cases.unlike, random) : skin);
  }
  for (double slope : cases.slopes) {
    SrdBatch b = GeometryOf(cases, slope, random);
    for (int i = 0; i < cases.profiles; ++i) {
      const auto y = PredictSamples(made.skins[i], b, i, options.scattering);
      const double counts = cases.peak_counts / *std::max_element(y.begin(), y.end());
      const double read = cases.read_photons > 0.0 ? cases.read_photons / counts : 2e-5;
      for (int k = 0; k < b.samples; ++k) {
        const double variance = (y[k] + read) / counts;
        b.y[i * b.samples + k] = static_cast<float>(y[k] + random.Normal() * std::sqrt(variance));
      }
      b.noise_floor[i] = static_cast<float>(read / counts);
      b.noise_slope[i] = static_cast<float>(1.0 / counts);
    }
    made.batches.push_back(std::move(b));
  }
  return made;
}

double ShapeError(const EmCases& made, const MixtureMap& map, const EmOptions& options, int every,
                  const EmCaseOptions& seen_by) {
  const int64_t profiles = std::ssize(made.skins);
  EmCaseOptions as_seen = seen_by;
  as_seen.profiles = static_cast<int>(profiles);
  as_seen.slopes = {1.0};
  const EmCases unseen = MakeEmCases(as_seen, options, 99);
  double squares = 0.0, judged = 0.0;
  for (int64_t i = 0; i < profiles; i += every) {
    const auto truth = PredictSamples(made.skins[i], unseen.batches[0], i, options.scattering);
    const auto guess = PredictSamples(LayersOf(map, i), unseen.batches[0], i, options.scattering);
    const double light = std::accumulate(truth.begin(), truth.end(), 0.0);
    const double guessed = std::accumulate(guess.begin(), guess.end(), 0.0);
    double error = 0.0, power = 0.0;
    for (size_t k = 0; k < truth.size(); ++k) {
      error += std::pow(guess[k] / guessed - truth[k] / light, 2);
      power += std::pow(truth[k] / light, 2);
    }
    squares += error / power;
    judged += 1.0;
  }
  return std::sqrt(squares / judged);
}

}  // namespace stratalux::fit
