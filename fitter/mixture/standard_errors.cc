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
  double square = 0.0;
  for (size_t l = 0; l < layers.weight.size(); ++l) {
    e.weight += layers.weight[l];
    e.depth += layers.weight[l] * layers.depth_mm[l];
    square += layers.weight[l] * layers.sigma_mm[l] * layers.sigma_mm[l];
  }
  e.depth /= e.weight;
  square /= e.weight;
  e.width = std::sqrt(square);
  for (size_t l = 0; l < layers.weight.size(); ++l) {
    const double share = layers.weight[l] / e.weight, sigma2 = layers.sigma_mm[l] * layers.sigma_mm[l];
    const auto changes = ChangesOf(t[l]);
    for (int j = 0; j < kBackground; ++j) {
      e.d_weight[j] += layers.weight[l] * changes[j][0];
      e.d_depth[j] += share * (changes[j][0] * (layers.depth_mm[l] - e.depth) + changes[j][1]);
      e.d_width[j] += share * (changes[j][0] * (sigma2 - square) + 2.0 * changes[j][2] * sigma2) / (2.0 * e.width);
    }
  }
  return e;
}

// What lights tell: along all changes, by their samples; and of the scale of a known shape, by samples and by whites.
struct Told {
  Information information = Information::Zero();
  double chi2 = 0.0;  // of the samples' residuals
  double scale_by_samples = 0.0, scale_by_white = 0.0;
};

void AddLight(const ProfileFit& fit, const std::vector<double>& t, const ProfileLight& light, size_t p, bool has_floor,
              Told& told) {
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
  double layers = 0.0;
  for (int k = 0; k < light.samples(); ++k) {
    const double y = model[k] + fit.background[p] + fit.surface[p] * grid.SurfaceResponse(k);
    Change j;
    for (int i = 0; i < kBackground; ++i) j[i] = slope[i][k];
    j[kBackground] = has_floor ? 1.0 : 0.0;
    layers += model[k];
    if (!(y + light.read_shift > 0.0)) continue;
    const double precision = light.counts / (y + light.read_shift);
    told.information += precision * j * j.transpose();
    told.scale_by_samples += precision * model[k] * model[k];
    told.chi2 += precision * (light.y[k] - y) * (light.y[k] - y);
  }
  if (light.white_variance > 0.0) told.scale_by_white += layers * layers / light.white_variance;
}

// Relative variance of the total weight: EM's, of relative variance `of_em`, is scaled by the mean of 1 and of what the
// white frames ask for, weighted by what both tell of the scale (EmBlock's ScaleToWhite).
double WeightVariance(double of_em, const Told& told) {
  const double all = told.scale_by_samples + told.scale_by_white, own = told.scale_by_samples / all;
  return told.scale_by_white > 0.0 ? own * own * of_em + told.scale_by_white / (all * all) : of_em;
}

// Curvature of the prior's cost, (5) of the page, along the changes, where the fit is near the prior's centre: shares
// of layers are held by their covariance, depths by N0 pi v / sigma^2, widths by 2 N0 pi.
Information PriorInformation(const LayerSet& layers, const std::vector<double>& t, const LayerPrior& prior) {
  Information held = Information::Zero();
  if (!(prior.photons > 0.0)) return held;
  const double total = std::accumulate(layers.weight.begin(), layers.weight.end(), 0.0);
  Change mean = Change::Zero();
  for (size_t l = 0; l < t.size(); ++l) {
    const double share = layers.weight[l] / total, sigma = layers.sigma_mm[l];
    if (!(share > 0.0)) continue;
    const auto changes = ChangesOf(t[l]);
    Change weight = Change::Zero(), depth = Change::Zero(), width = Change::Zero();
    for (int j = 0; j < kBackground; ++j) {
      weight[j] = changes[j][0];
      depth[j] = changes[j][1] / sigma;
      width[j] = changes[j][2];
    }
    mean += share * weight;
    held += share * (weight * weight.transpose() + prior.square_shift * depth * depth.transpose() +
                     2.0 * width * width.transpose());
  }
  return prior.photons * (held - mean * mean.transpose());
}

// What the layers' ranges tell by themselves; the floor's is the whole profile's light.
Change PriorPrecision(const ProfileFit& fit) {
  Change precision = Change::Ones();
  const double most = *std::max_element(fit.layers.weight.begin(), fit.layers.weight.end());
  precision[kBackground] = 1.0 / (most * most);
  return precision;
}

}  // namespace

EffectiveParameters EffectiveParametersOf(const ProfileFit& fit, std::span<const ProfileLight> lights, NoiseScale noise,
                                          const KnownBeside& beside) {
  const double total = std::accumulate(fit.layers.weight.begin(), fit.layers.weight.end(), 0.0);
  if (!(total > 0.0)) return {};
  const std::vector<double> t = LogWidths(fit.layers);
  Told told;
  double samples = 0.0;
  for (size_t p = 0; p < lights.size(); ++p) {
    AddLight(fit, t, lights[p], p, beside.has_floor, told);
    samples += lights[p].samples();
  }
  Information& information = told.information;
  if (noise == NoiseScale::kFromResiduals && told.chi2 > 0.0)
    information *= std::max(samples - kChanges, 1.0) / told.chi2;
  information += PriorInformation(fit.layers, t, beside.prior);
  information.diagonal() += PriorPrecision(fit);
  const Information covariance = information.ldlt().solve(Information::Identity());
  const Effective e = EffectiveOf(fit.layers, t);
  auto estimate = [&](double value, const Change& gradient) {
    return Estimate{value, std::sqrt(std::max(0.0, gradient.dot(covariance * gradient)))};
  };
  EffectiveParameters found{estimate(e.weight, e.d_weight), estimate(e.depth, e.d_depth), estimate(e.width, e.d_width)};
  double& of_weight = found.total_weight.standard_error;
  of_weight = e.weight * std::sqrt(WeightVariance(of_weight * of_weight / (e.weight * e.weight), told));
  return found;
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
  // Neighbours know a pixel better than the session's mean does, but how far it lies from them is no noise of theirs:
  // by their many photons half of the widths of a very light face were within their intervals.
  return EffectiveParametersOf(fit, seen, NoiseScale::kKnown,
                               {{map.SessionPhotons(), options.prior.square_shift}, options.background_term});
}

}  // namespace stratalux::fit
