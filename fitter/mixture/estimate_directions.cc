// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/estimate_directions.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>
#include <vector>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/line_response.h"
#include "fitter/mixture/sampled_lights.h"
#include "fitter/mixture/shift_law.h"
#include "shared/base/check.h"

namespace stratalux::fit {
namespace {

// Photons of a profile: the square of its signal over its noise.
double Photons(std::span<const SrdBatch* const> lights, int64_t profile) {
  double photons = 0.0;
  for (const SrdBatch* b : lights) {
    if (!b->Shares(profile)) continue;
    const auto y = b->Samples(profile);
    const double sum = std::accumulate(y.begin(), y.end(), 0.0), variance = b->VarianceOfSum(profile);
    if (std::isfinite(sum) && variance > 0.0) photons += sum * sum / variance;
  }
  return photons;
}

// What of a light comes back from beyond the reach of the surface's own reflection.
struct Scattered {
  double light = 0.0;
  double fresnel = 1.0, path = 0.0;  // the gain is fresnel exp(-tau path)
};

// How far that reflection is seen.
double ReachOfSurface(const SrdBatch& batch, int64_t i) {
  return 0.5 * batch.line_width_mm[i] + 3.0 * batch.blur_mm[i] + SampleSitesOf(batch, i).ReachMm();
}

std::optional<Scattered> ScatteredLight(const SrdBatch& batch, int64_t i, double reach, double eta) {
  if (!batch.Shares(i) || batch.cos_in[i] < 0.4F) return std::nullopt;
  const double step = batch.step_mm[i], period = step * batch.samples;
  const auto y = batch.Samples(i);
  Scattered s;
  for (int k = 0; k < batch.samples; ++k) {
    const double u = batch.first_u_mm[i] + k * step;
    if (std::abs(batch.wrapped ? std::remainder(u, period) : u) < reach) continue;
    s.light += y[k];
  }
  if (!std::isfinite(s.light)) return std::nullopt;
  s.fresnel = AngularGain(batch.cos_in[i], eta, 0.0);
  s.path = GainPath(batch.cos_in[i], eta);
  return s;
}

// tau of the light that spread: least squares of log(sum of light_p / F_p) = a - tau path_p, one a for each run of
// neighbouring pixels, whose sum is quiet. Light reflected at the surface itself, which is brightest near normal
// incidence, has no part in it.
double TauOfScatteredLight(std::span<const SrdBatch* const> lights, int channels, double eta, double otherwise) {
  constexpr int kRun = 32, kAtLeast = 8;  // pixels
  const int64_t pixels = lights[0]->profiles() / channels;
  double xy = 0.0, xx = 0.0;
  for (int64_t first = 0; first < pixels; first += kRun)
    for (int c = 0; c < channels; ++c) {
      std::vector<Scattered> sums(lights.size());
      int count = 0;
      for (int64_t at = first; at < std::min(first + kRun, pixels); ++at) {
        const int64_t i = at * channels + c;
        double reach = 0.0;  // the same for all lights, whose lines are of different widths on the skin
        for (const SrdBatch* batch : lights) reach = std::max(reach, ReachOfSurface(*batch, i));
        std::vector<Scattered> of_lights;
        for (const SrdBatch* batch : lights)
          if (const auto s = ScatteredLight(*batch, i, reach, eta)) of_lights.push_back(*s);
        if (of_lights.size() < lights.size()) continue;
        ++count;
        for (size_t p = 0; p < lights.size(); ++p) {
          sums[p].light += of_lights[p].light / of_lights[p].fresnel;
          sums[p].path += of_lights[p].path;
        }
      }
      if (count < kAtLeast || std::any_of(sums.begin(), sums.end(), [](const auto& s) { return !(s.light > 0.0); }))
        continue;
      double mx = 0.0, my = 0.0;
      for (Scattered& s : sums) {
        s.path /= count;
        s.light = std::log(s.light);
        mx += s.path / static_cast<double>(sums.size());
        my += s.light / static_cast<double>(sums.size());
      }
      for (const Scattered& s : sums) {
        // Shadows nearby are outliers: bounded influence.
        xy += (s.path - mx) * std::clamp(s.light - my, -0.3, 0.3);
        xx += (s.path - mx) * (s.path - mx);
      }
    }
  return xx > 1e-4 ? std::clamp(-xy / xx, 0.0, 3.0) : otherwise;
}

// kappa, phase slope, sigma_0.
using Parameters = std::array<double, 3>;
constexpr Parameters kFirstStep = {0.2, 0.5, 0.4}, kMost = {3.0, 3.0, 2.0};
constexpr int kHalvings = 2;
constexpr double kWorthwhile = 1e-4;  // of the divergence

EmOptions With(EmOptions options, const Parameters& at) {
  options.scattering.directional = {at[0], at[1], at[2]};
  return options;
}

}  // namespace

Result<DirectionEstimate> EstimateDirections(std::span<const SrdBatch* const> lights, int channels, EmOptions options,
                                             int every) {
  SLX_CHECK(every >= 1 && !lights.empty());
  if (options.scattering.gain_model && !options.scattering.reflection.Known())
    options.scattering.tau = TauOfScatteredLight(lights, channels, options.scattering.eta, options.scattering.tau);
  const std::vector<SrdBatch> parts = SampledPixels(lights, channels, every);
  std::vector<const SrdBatch*> sampled;
  for (const SrdBatch& b : parts) sampled.push_back(&b);
  const int pixels = static_cast<int>(parts.front().profiles() / channels);
  const std::vector<int> projectors(sampled.size(), 0);
  std::vector<double> photons;
  for (int64_t i = 0; i < parts.front().profiles(); ++i) photons.push_back(Photons(sampled, i));

  auto divergence_of = [&](const Parameters& at) -> Result<double> {
    SLX_ASSIGN_OR_RETURN(const auto map, FitMixture(sampled, projectors, pixels, 1, channels, With(options, at)));
    double sum = 0.0, weights = 0.0;
    for (int64_t i = 0; i < map.profiles(); ++i) {
      if (!map.Fitted(i)) continue;
      sum += photons[i] * map.divergence[i];
      weights += photons[i];
    }
    return weights > 0.0 ? sum / weights : 0.0;
  };
  Parameters best{};
  SLX_ASSIGN_OR_RETURN(double least, divergence_of(best));
  const double without = least;
  Parameters step = kFirstStep;
  for (int halving = 0; halving <= kHalvings;) {
    bool moved = false;
    for (size_t k = 0; k < best.size(); ++k)
      for (const double sense : {1.0, -1.0}) {
        if (k == 1 && best[2] == 0.0) continue;  // no narrow layer: no phase
        Parameters trial = best;
        trial[k] = std::clamp(best[k] + sense * step[k], 0.0, kMost[k]);
        if (trial[k] == best[k]) continue;
        SLX_ASSIGN_OR_RETURN(const double divergence, divergence_of(trial));
        if (!(divergence < least * (1.0 - kWorthwhile))) continue;
        best = trial;
        least = divergence;
        moved = true;
        break;
      }
    if (moved) continue;
    ++halving;
    for (double& s : step) s /= 2.0;
  }
  return DirectionEstimate{options.scattering.tau, {best[0], best[1], best[2]}, least, without};
}

}  // namespace stratalux::fit
