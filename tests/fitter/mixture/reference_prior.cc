// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/mixture/reference_prior.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace stratalux::fit {
namespace {

// pi log(pi / q) and its like, summed over shares that add up to the same.
double Apart(double photons, double expected) {
  return photons > 0.0 ? photons * std::log(photons / std::max(expected, 1e-300)) + expected - photons : 0.0;
}

// Photons of surface and floor of weight 1 under a light.
double SurfaceExposure(const FineGrid& grid) {
  double sum = 0.0;
  for (int k = 0; k < grid.light().samples(); ++k) sum += grid.SurfaceResponse(k);
  return grid.light().counts * sum;
}
// The surface is known, and no part of what the prior binds.
bool Held(const FineGrid& grid) { return grid.light().reflected >= 0.0; }
double FloorExposure(const FineGrid& grid) { return grid.light().counts * grid.light().samples(); }

}  // namespace

double ShownPhotons::Sum() const {
  double sum = 0.0;
  for (const auto* of : {&layers, &surface, &background}) sum = std::accumulate(of->begin(), of->end(), sum);
  return sum;
}

ShownPhotons ShownBy(const ProfileFit& fit, std::span<const FineGrid> grids) {
  ShownPhotons shown;
  for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
    double photons = 0.0;
    for (const FineGrid& grid : grids)
      photons += grid.light().counts * grid.Coverage() * fit.layers.weight[l] *
                 LayerFactor(grid.light(), fit, fit.layers.depth_mm[l], fit.layers.sigma_mm[l]);
    shown.layers.push_back(photons);
  }
  for (size_t p = 0; p < grids.size(); ++p) {
    shown.surface.push_back(Held(grids[p]) ? 0.0 : SurfaceExposure(grids[p]) * fit.surface[p]);
    shown.background.push_back(FloorExposure(grids[p]) * fit.background[p]);
  }
  return shown;
}

KnownPixel::KnownPixel(const ProfileFit& fit, std::span<const FineGrid> grids, const EmOptions& options)
    : fit_(fit),
      grids_(grids),
      n0_(options.prior.photons),
      square_shift_(options.scattering.mode == FitMode::kFree ? 0.0 : options.prior.square_shift),
      photons_(ShownBy(fit, grids)) {
  const double scale = n0_ / photons_.Sum();
  for (auto* of : {&photons_.layers, &photons_.surface, &photons_.background})
    for (double& photons : *of) photons *= scale;
}

double KnownPixel::Cost(const ProfileFit& fit) const {
  const ShownPhotons shown = ShownBy(fit, grids_);
  const double scale = n0_ / shown.Sum();
  double cost = 0.0;
  for (size_t l = 0; l < shown.layers.size(); ++l) {
    const double n = photons_.layers[l], sigma = fit.layers.sigma_mm[l], known = fit_.layers.sigma_mm[l];
    const double away = fit.layers.depth_mm[l] - fit_.layers.depth_mm[l];
    cost += Apart(n, scale * shown.layers[l]) +
            n * (std::log(sigma / known) + 0.5 * (known * known + square_shift_ * away * away) / (sigma * sigma) - 0.5);
  }
  for (size_t p = 0; p < grids_.size(); ++p)
    cost += Apart(photons_.surface[p], scale * shown.surface[p]) +
            Apart(photons_.background[p], scale * shown.background[p]);
  return cost;
}

// n photons at d0 s, about the old mean d s.
void KnownPixel::AddLayer(size_t layer, double old_depth_mm, LayerSums& sums) const {
  const double n = photons_.layers[layer], sigma = fit_.layers.sigma_mm[layer];
  const double away = fit_.layers.depth_mm[layer] - old_depth_mm;
  sums.photons += n;
  sums.moved += n * square_shift_ * away;
  sums.leverage += n * square_shift_;
  sums.spread += n * (sigma * sigma + square_shift_ * away * away);
}

void KnownPixel::AddFloor(size_t light, ProfileFit& fit) const {
  const double surface = SurfaceExposure(grids_[light]);
  if (surface > 0.0) fit.surface[light] += photons_.surface[light] / surface;
  fit.background[light] += photons_.background[light] / FloorExposure(grids_[light]);
}

void KnownPixel::KeepTotal(ProfileFit& fit) const {
  const double own = std::max(1.0 - n0_ / ShownBy(fit, grids_).Sum(), 0.0);
  for (auto* terms : {&fit.layers.weight, &fit.background})
    for (double& v : *terms) v *= own;
  for (size_t p = 0; p < grids_.size(); ++p)
    if (!Held(grids_[p])) fit.surface[p] *= own;
}

}  // namespace stratalux::fit
