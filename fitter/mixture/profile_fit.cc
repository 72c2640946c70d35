// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/profile_fit.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace stratalux::fit {

double LayerFactor(const ProfileLight& light, const ProfileFit& fit, double depth_mm, double sigma_mm) {
  return light.Gain(fit.tau) * DirectionalFactor(fit.directional, light.directions, depth_mm, sigma_mm);
}

std::vector<double> ModelOf(const ProfileFit& fit, const FineGrid& grid, size_t p) {
  const ProfileLight& light = grid.light();
  std::vector<double> mass(grid.cells(), 0.0), phi(grid.cells());
  for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
    if (!(fit.layers.weight[l] > 0.0)) continue;
    const double d = fit.layers.depth_mm[l], sigma = fit.layers.sigma_mm[l];
    const double weight = fit.layers.weight[l] * LayerFactor(light, fit, d, sigma);
    grid.Layer(d * light.s, sigma, phi);
    for (int c = 0; c < grid.cells(); ++c) mass[c] += weight * phi[c];
  }
  std::vector<double> y = grid.Project(mass);
  for (int k = 0; k < light.samples(); ++k) y[k] += fit.background[p] + fit.surface[p] * grid.SurfaceResponse(k);
  return y;
}

Misfit MisfitOf(const ProfileLight& light, const std::vector<double>& model) {
  constexpr double kTiny = 1e-12;
  Misfit misfit;
  for (int k = 0; k < light.samples(); ++k) {
    const double data = std::max(light.y[k] + light.read_shift, 0.0);
    const double expected = std::max(model[k] + light.read_shift, kTiny);
    misfit.divergence += light.counts * (expected - data + (data > 0.0 ? data * std::log(data / expected) : 0.0));
    misfit.photons += light.counts * data;
  }
  return misfit;
}

LayerSet SpreadLayers(std::span<const ProfileLight> lights, const EmOptions& options) {
  double photons = 0.0, exposure = 0.0, longest = 0.0, narrowest = options.min_sigma_mm;
  for (const ProfileLight& light : lights) {
    const FineGrid grid(light);
    photons += light.counts * std::max(std::accumulate(light.y.begin(), light.y.end(), 0.0), 1e-6);
    exposure += light.counts * light.Gain(options.scattering.tau) * grid.Coverage();
    longest = std::max(longest, grid.CellMm() * grid.cells());
    narrowest = std::max(narrowest, 0.9 * grid.CellMm());
  }
  const double widest = std::min(options.max_sigma_mm, longest / 4.0);
  LayerSet set;
  double share = 0.0;
  for (int l = 0; l < options.layers; ++l) {
    const double f = options.layers > 1 ? static_cast<double>(l) / (options.layers - 1) : 0.5;
    const double sigma = narrowest * 1.1 * std::pow(std::max(widest * 0.7, narrowest * 2.0) / (narrowest * 1.1), f);
    set.sigma_mm.push_back(sigma);
    set.depth_mm.push_back(options.direction_blind ? 0.0 : std::min(0.3 * sigma, 1.0));
    set.weight.push_back(photons / exposure / sigma);
    share += 1.0 / sigma;
  }
  for (double& w : set.weight) w /= share;
  return set;
}

}  // namespace stratalux::fit
