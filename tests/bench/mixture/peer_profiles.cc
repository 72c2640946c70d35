// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/mixture/peer_profiles.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>
#include <numeric>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/profile_fit.h"

namespace stratalux::bench {
namespace {

fit::SrdBatch AsPeersTakeThem(fit::SrdBatch b) {
  constexpr double kFarthestMm = 7.5;
  b.line_width_mm = b.step_mm;
  std::fill(b.blur_mm.begin(), b.blur_mm.end(), 0.0F);
  for (size_t i = 0; i < b.y.size(); ++i) {
    const size_t profile = i / b.samples;
    const double u = double(b.first_u_mm[profile]) + static_cast<double>(i % b.samples) * double(b.step_mm[profile]);
    b.y[i] = std::abs(u) < kFarthestMm ? std::max(b.y[i], 0.0F) : 0.0F;
  }
  std::fill(b.noise_floor.begin(), b.noise_floor.end(), 0.0F);
  std::fill(b.noise_slope.begin(), b.noise_slope.end(), 1.0F / static_cast<float>(kPeerPhotons));
  return b;
}

fit::SrdBatch WithoutNoise(const fit::EmCases& skins) {
  fit::SrdBatch b = skins.batches[0];
  for (int i = 0; i < kPeerProfiles; ++i) {
    const auto y = fit::PredictSamples(skins.skins[i], b, i, fit::ScatteringModel());
    std::copy(y.begin(), y.end(), b.y.begin() + int64_t{i} * b.samples);
  }
  return b;
}

void WritePhotons(std::ostream& out, const char* name, const Photons& photons) {
  out << name << ' ' << photons.first_mm << ' ' << photons.step_mm;
  for (double n : photons.at) out << ' ' << n;
  out << '\n';
}

}  // namespace

Photons PhotonsOf(const fit::SrdBatch& batch, int64_t profile, int per_sample, double total) {
  Photons p;
  p.step_mm = double(batch.step_mm[profile]) / per_sample;
  p.first_mm = double(batch.first_u_mm[profile]) - 0.5 * (per_sample - 1) * p.step_mm;
  const float* y = batch.y.data() + profile * batch.samples;
  double sum = 0.0;
  for (int k = 0; k < batch.samples; ++k) sum += std::max(double(y[k]), 0.0);
  for (int k = 0; k < batch.samples; ++k)
    for (int j = 0; j < per_sample; ++j) p.at.push_back(total * std::max(double(y[k]), 0.0) / (sum * per_sample));
  return p;
}

double DivergenceOf(const Photons& photons, const fit::LayerSet& layers) {
  const auto below = [&](double x) {
    double sum = 0.0;
    for (size_t l = 0; l < layers.weight.size(); ++l)
      sum += layers.weight[l] * 0.5 * std::erfc((layers.depth_mm[l] - x) / (layers.sigma_mm[l] * std::numbers::sqrt2));
    return sum;
  };
  const double total = std::accumulate(photons.at.begin(), photons.at.end(), 0.0);
  const double start = photons.first_mm - 0.5 * photons.step_mm;
  const double span = photons.step_mm * static_cast<double>(photons.at.size());
  const double model_total = below(start + span) - below(start);
  double divergence = 0.0;
  for (size_t i = 0; i < photons.at.size(); ++i) {
    const double left = start + static_cast<double>(i) * photons.step_mm;
    const double p = photons.at[i] / total, q = (below(left + photons.step_mm) - below(left)) / model_total;
    if (p > 0.0) divergence += p * std::log(p / std::max(q, 1e-12));
  }
  return divergence;
}

PeerProfiles MakePeerProfiles(const fit::EmCases& skins) {
  return {AsPeersTakeThem(skins.batches[0]), AsPeersTakeThem(WithoutNoise(skins))};
}

fit::EmOptions PeerOptions(int sweeps) {
  fit::EmOptions options;
  options.layers = kPeerLayers;
  options.max_iterations = sweeps;
  options.tolerance = 0.0;
  options.scattering.mode = fit::FitMode::kFree;
  options.scattering.gain_model = options.surface_term = options.background_term = false;
  return options;
}

fit::LayerSet OwnStart(const fit::SrdBatch& noisy, int profile) {
  const fit::EmOptions options = PeerOptions(kPeerSweeps);
  const fit::ProfileLight light = fit::ProfileLightOf(noisy, profile, options);
  fit::LayerSet start = fit::SpreadLayers(std::span(&light, 1), options);
  const double sum = std::accumulate(start.weight.begin(), start.weight.end(), 0.0);
  for (double& w : start.weight) w /= sum;
  return start;
}

bool WritePeerProfiles(const PeerProfiles& profiles, const std::string& path) {
  std::ofstream out(path);
  out.precision(9);
  for (int i = 0; i < kPeerProfiles; ++i) {
    WritePhotons(out, "noisy", PhotonsOf(profiles.noisy, i, 1, kPeerPhotons));
    WritePhotons(out, "truth", PhotonsOf(profiles.truth, i, 1, kPeerPhotons));
    const fit::LayerSet start = OwnStart(profiles.noisy, i);
    out << "start";
    for (size_t l = 0; l < start.weight.size(); ++l)
      out << ' ' << start.weight[l] << ' ' << start.depth_mm[l] << ' ' << start.sigma_mm[l];
    out << '\n';
  }
  return static_cast<bool>(out.flush());
}

}  // namespace stratalux::bench
