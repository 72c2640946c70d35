// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/standard_errors.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "fitter/mixture/fine_grid.h"

namespace stratalux::fit {
namespace {

constexpr int kChanges = 7;  // a0 a1 a2 b0 b1 c e
constexpr int kBackground = 6;
using Change = Eigen::Matrix<double, kChanges, 1>;
using Information = Eigen::Matrix<double, kChanges, kChanges>;

// t_l, centred where the light is.
std::vector<double> LogWidths(const LayerSet& layers) {
  std::vector<double> t;
  double mean = 0.0, total = 0.0;
  for (size_t l = 0; l < layers.weight.size(); ++l) {
    t.push_back(std::log(std::max(layers.sigma_mm[l], 1e-6)));
    mean += layers.weight[l] * t[l];
    total += layers.weight[l];
  }
  for (double& v : t) v -= mean / total;
  return t;
}

// A change of all layers as derivatives of one layer's {weight (relative), depth, sigma (relative)}.
std::array<std::array<double, 3>, kBackground> ChangesOf(double t) {
  return {{{1, 0, 0}, {t, 0, 0}, {t * t, 0, 0}, {0, 1, 0}, {0, t, 0}, {0, 0, 1}}};
}

struct Effective {
  double weight = 0.0, depth = 0.0, width = 0.0;
  Change d_weight = Change::Zero(), d_depth = Change::Zero(), d_width = Change::Zero();
};

Effective EffectiveOf(const LayerSet& layers, const std::vector<double>& t) {
  Effective e;
  for (size_t l = 0; l < layers.weight.size(); ++l) {
    e.weight += layers.weight[l];
    e.depth += layers.weight[l] * layers.depth_mm[l];
    e.width += layers.weight[l] * layers.sigma_mm[l];
  }
  e.depth /= e.weight;
  e.width /= e.weight;
  for (size_t l = 0; l < layers.weight.size(); ++l) {
    const double share = layers.weight[l] / e.weight, sigma = layers.sigma_mm[l];
    const auto changes = ChangesOf(t[l]);
    for (int j = 0; j < kBackground; ++j) {
      e.d_weight[j] += layers.weight[l] * changes[j][0];
      e.d_depth[j] += share * (changes[j][0] * (layers.depth_mm[l] - e.depth) + changes[j][1]);
      e.d_width[j] += share * (changes[j][0] * (sigma - e.width) + changes[j][2] * sigma);
    }
  }
  return e;
}

// Adds one light's samples to the information and to the residuals' chi^2.
void AddLight(const ProfileFit& fit, const std::vector<double>& t, const ProfileLight& light, size_t p,
              Information& information, double& chi2) {
  const FineGrid grid(light);
  std::vector<double> mass(grid.cells(), 0.0);
  std::array<std::vector<double>, kBackground> changed;
  changed.fill(mass);
  for (size_t l = 0; l < t.size(); ++l) {
    const double depth = fit.layers.depth_mm[l], sigma = fit.layers.sigma_mm[l];
    const double weight = fit.layers.weight[l] * LayerFactor(light, fit, depth, sigma);
    if (!(weight > 0.0)) continue;
    const auto changes = ChangesOf(t[l]);
    grid.ForEachCell(depth * light.s, sigma, [&](int c, double x, double phi) {
      const double m = weight * phi, z = x / sigma;
      mass[c] += m;
      for (int j = 0; j < kBackground; ++j)
        changed[j][c] += m * (changes[j][0] + changes[j][1] * light.s * z / sigma + changes[j][2] * (z * z - 1.0));
    });
  }
  const std::vector<double> model = grid.Project(mass);
  std::array<std::vector<double>, kBackground> slope;
  for (int j = 0; j < kBackground; ++j) slope[j] = grid.Project(changed[j]);
  for (int k = 0; k < light.samples(); ++k) {
    const double y = model[k] + fit.background[p] + fit.surface[p] * grid.SurfaceResponse(k);
    if (!(y + light.read_shift > 0.0)) continue;
    const double precision = light.counts / (y + light.read_shift);
    Change j;
    for (int i = 0; i < kBackground; ++i) j[i] = slope[i][k];
    j[kBackground] = 1.0;
    information += precision * j * j.transpose();
    chi2 += precision * (light.y[k] - y) * (light.y[k] - y);
  }
}

// What the layers' ranges tell by themselves; the floor's is the whole profile's light.
Change PriorPrecision(const ProfileFit& fit) {
  Change precision = Change::Ones();
  const double most = *std::max_element(fit.layers.weight.begin(), fit.layers.weight.end());
  precision[kBackground] = 1.0 / (most * most);
  return precision;
}

}  // namespace

EffectiveParameters EffectiveParametersOf(const ProfileFit& fit, std::span<const ProfileLight> lights,
                                          NoiseScale noise) {
  const double total = std::accumulate(fit.layers.weight.begin(), fit.layers.weight.end(), 0.0);
  if (!(total > 0.0)) return {};
  const std::vector<double> t = LogWidths(fit.layers);
  Information information = Information::Zero();
  double chi2 = 0.0, samples = 0.0;
  for (size_t p = 0; p < lights.size(); ++p) {
    AddLight(fit, t, lights[p], p, information, chi2);
    samples += lights[p].samples();
  }
  if (noise == NoiseScale::kFromResiduals && chi2 > 0.0) information *= std::max(samples - kChanges, 1.0) / chi2;
  information.diagonal() += PriorPrecision(fit);
  const Information covariance = information.ldlt().solve(Information::Identity());
  const Effective e = EffectiveOf(fit.layers, t);
  auto estimate = [&](double value, const Change& gradient) {
    return Estimate{value, std::sqrt(std::max(0.0, gradient.dot(covariance * gradient)))};
  };
  return {estimate(e.weight, e.d_weight), estimate(e.depth, e.d_depth), estimate(e.width, e.d_width)};
}

EffectiveParameters EffectiveParametersOf(const MixtureMap& map, int64_t profile,
                                          std::span<const SrdBatch* const> lights, const EmOptions& options) {
  if (!map.Fitted(profile)) return {};
  ProfileFit fit;
  fit.layers = LayersOf(map, profile);
  fit.tau = map.scattering.tau;
  fit.directional = options.scattering.directional;
  std::vector<ProfileLight> seen;
  for (size_t p = 0; p < lights.size(); ++p) {
    if (lights[p]->valid[profile] == 0) continue;
    seen.push_back(ProfileLightOf(*lights[p], profile, options));
    fit.surface.push_back(map.surface[profile * lights.size() + p]);
    fit.background.push_back(map.background[profile * lights.size() + p]);
  }
  return EffectiveParametersOf(fit, seen, NoiseScale::kKnown);
}

}  // namespace stratalux::fit
