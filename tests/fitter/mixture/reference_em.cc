// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/mixture/reference_em.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include "tests/fitter/mixture/reference_prior.h"

namespace stratalux::fit {
namespace {

constexpr double kTiny = 1e-12;
constexpr double kFreeReachMm = 8.0;  // of a mean in free mode

using Vector = std::vector<double>;

// Expected photons c of each layer in each light, and their moments about the layer's mean.
struct Expected {
  std::vector<Vector> c, cx, cxx;  // [light][layer], in photons
  explicit Expected(size_t lights, size_t layers) : c(lights, Vector(layers)), cx(c), cxx(c) {}
};

class ReferenceEm {
 public:
  ReferenceEm(std::span<const ProfileLight> lights, const EmOptions& options) : options_(options) {
    for (const ProfileLight& light : lights) grids_.emplace_back(light);
    for (const ProfileLight& light : lights)
      for (double y : light.y) total_photons_ += light.counts * std::max(y + light.read_shift, 0.0);
    sigma_floor_ = options.min_sigma_mm;
    for (const FineGrid& grid : grids_) sigma_floor_ = std::max(sigma_floor_, 0.9 * grid.CellMm());
  }

  [[nodiscard]] ProfileFit Start(const LayerSet& layers) const;
  // From now on with the prior of `options.prior.photons` photons of that pixel.
  void SetPrior(const ProfileFit& known) { known_.emplace(known, grids_, options_); }
  // One sweep; `objective_before` receives that of `fit`.
  [[nodiscard]] ProfileFit Sweep(const ProfileFit& fit, double* objective_before) const;
  [[nodiscard]] double Divergence(const ProfileFit& fit) const;
  // What EM lowers: the divergence and the prior.
  [[nodiscard]] double Objective(const ProfileFit& fit) const;

 private:
  void UpdateFloor(ProfileFit& fit, size_t p, const Vector& ratio) const;
  void ShareBackground(ProfileFit& fit) const;
  void UpdateLayers(ProfileFit& fit, const Expected& expected) const;
  void UpdateWeights(ProfileFit& fit, const Expected& expected) const;
  [[nodiscard]] double PriorCost(const ProfileFit& fit) const;

  EmOptions options_;
  std::vector<FineGrid> grids_;
  std::optional<KnownPixel> known_;
  double sigma_floor_ = 0.0;
  double total_photons_ = 0.0;
};

ProfileFit ReferenceEm::Start(const LayerSet& layers) const {
  ProfileFit fit;
  fit.layers = layers;
  fit.tau = options_.scattering.tau;
  fit.directional = options_.scattering.directional;
  // Shares of the light that returns: an unknown surface keeps near its start (nothing identifies it), the floor is
  // small.
  const double total = std::accumulate(layers.weight.begin(), layers.weight.end(), 0.0);
  for (const FineGrid& grid : grids_) {
    const double light_total = total * grid.light().Gain(fit.tau);
    const double reflected = grid.light().reflected;
    const double surface = reflected < 0.0 ? kUnknownSurface * light_total : reflected;
    fit.surface.push_back(options_.surface_term ? surface : 0.0);
    fit.background.push_back(options_.background_term ? 0.02 * light_total * grid.Coverage() / grid.light().samples()
                                                      : 0.0);
  }
  if (options_.shared_background) ShareBackground(fit);
  for (double& sigma : fit.layers.sigma_mm) sigma = std::max(sigma, sigma_floor_);
  if (options_.direction_blind) std::fill(fit.layers.depth_mm.begin(), fit.layers.depth_mm.end(), 0.0);
  return fit;
}

double ReferenceEm::PriorCost(const ProfileFit& fit) const { return known_ ? known_->Cost(fit) / total_photons_ : 0.0; }

double ReferenceEm::Objective(const ProfileFit& fit) const { return Divergence(fit) + PriorCost(fit); }

double ReferenceEm::Divergence(const ProfileFit& fit) const {
  double divergence = 0.0, total = 0.0;
  for (size_t p = 0; p < grids_.size(); ++p) {
    const Misfit misfit = MisfitOf(grids_[p].light(), ModelOf(fit, grids_[p], p));
    divergence += misfit.divergence;
    total += misfit.photons;
  }
  return total > 0.0 ? divergence / total : 0.0;
}

ProfileFit ReferenceEm::Sweep(const ProfileFit& fit, double* objective_before) const {
  const size_t layers = fit.layers.weight.size();
  ProfileFit next = fit;
  Expected expected(grids_.size(), layers);
  double divergence = 0.0, total = 0.0;
  for (size_t p = 0; p < grids_.size(); ++p) {
    const FineGrid& grid = grids_[p];
    const ProfileLight& light = grid.light();
    // E step: the ratio of data and model, back through the line response; cells that no sample sees are filled in by
    // the model's own expectation (exact EM of a truncated observation).
    const Vector model = ModelOf(fit, grid, p);
    const Misfit misfit = MisfitOf(light, model);
    divergence += misfit.divergence;
    total += misfit.photons;
    Vector ratio(light.samples());
    for (int k = 0; k < light.samples(); ++k)
      ratio[k] = std::max(light.y[k] + light.read_shift, 0.0) / std::max(model[k] + light.read_shift, kTiny);
    Vector q = grid.BackProject(ratio);
    if (!light.wrapped)
      for (int c = 0; c < grid.cells(); ++c) q[c] += grid.Unseen(c);
    for (size_t l = 0; l < layers; ++l) {
      if (!(fit.layers.weight[l] > 0.0)) continue;
      const double depth = fit.layers.depth_mm[l], sigma = fit.layers.sigma_mm[l];
      const double photons = light.counts * fit.layers.weight[l] * LayerFactor(light, fit, depth, sigma);
      const auto moments = grid.Moments(depth * light.s, sigma, q);
      expected.c[p][l] = photons * moments[0];
      expected.cx[p][l] = photons * moments[1];
      expected.cxx[p][l] = photons * moments[2];
    }
    UpdateFloor(next, p, ratio);
  }
  if (options_.shared_background) ShareBackground(next);
  UpdateLayers(next, expected);
  UpdateWeights(next, expected);
  if (known_) known_->KeepTotal(next);
  *objective_before = (total > 0.0 ? divergence / total : 0.0) + PriorCost(fit);
  return next;
}

void ReferenceEm::UpdateFloor(ProfileFit& fit, size_t p, const Vector& ratio) const {
  double own_ratio = 0.0, own = 0.0, mean = 0.0;
  for (size_t k = 0; k < ratio.size(); ++k) {
    own_ratio += ratio[k] * grids_[p].SurfaceResponse(static_cast<int>(k));
    own += grids_[p].SurfaceResponse(static_cast<int>(k));
    mean += ratio[k] / static_cast<double>(ratio.size());
  }
  if (grids_[p].light().reflected < 0.0) fit.surface[p] *= own_ratio / std::max(own, kTiny);
  fit.background[p] *= mean;
  if (known_) known_->AddFloor(p, fit);
}

// One floor for all lights: the mean of theirs, weighted by the photons each would see of it.
void ReferenceEm::ShareBackground(ProfileFit& fit) const {
  double photons = 0.0, exposure = 0.0;
  for (size_t p = 0; p < grids_.size(); ++p) {
    const double seen = grids_[p].light().counts * grids_[p].light().samples();
    photons += seen * fit.background[p];
    exposure += seen;
  }
  std::fill(fit.background.begin(), fit.background.end(), photons / exposure);
}

// d_l = sum_p s_p sum_z c z / sum_p s_p^2 sum_z c and sigma_l^2 = sum c (z - d_l s_p)^2 / sum c, with z = d_old s + x.
void ReferenceEm::UpdateLayers(ProfileFit& fit, const Expected& expected) const {
  const bool free = options_.scattering.mode == FitMode::kFree;
  for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
    LayerSums sums;
    for (size_t p = 0; p < grids_.size(); ++p) {
      const double s = grids_[p].light().s;
      sums.photons += expected.c[p][l];
      sums.moved += s * expected.cx[p][l];
      sums.leverage += s * s * expected.c[p][l];
      sums.spread += expected.cxx[p][l];
    }
    if (known_) known_->AddLayer(l, fit.layers.depth_mm[l], sums);
    if (!(sums.photons > 0.0)) continue;
    double step = 0.0;
    if (!options_.direction_blind && sums.leverage > 1e-6 * sums.photons) {
      double& depth = fit.layers.depth_mm[l];
      const double wanted = depth + sums.moved / sums.leverage;
      step = (free ? std::clamp(wanted, -kFreeReachMm, kFreeReachMm)
                   : std::clamp(wanted, options_.min_depth_mm, options_.max_depth_mm)) -
             depth;
      depth += step;
    }
    const double variance = (sums.spread - 2.0 * step * sums.moved + step * step * sums.leverage) / sums.photons;
    fit.layers.sigma_mm[l] =
        std::clamp(std::sqrt(std::max(variance, 0.0)), sigma_floor_, std::max(options_.max_sigma_mm, sigma_floor_));
  }
}

// w_l = sum_p c_lp / sum_p n_p g_p (w_lp / w_l) A_p.
void ReferenceEm::UpdateWeights(ProfileFit& fit, const Expected& expected) const {
  double most = 0.0;
  for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
    double photons = 0.0, exposure = 0.0;
    for (size_t p = 0; p < grids_.size(); ++p) {
      const ProfileLight& light = grids_[p].light();
      photons += expected.c[p][l];
      exposure +=
          light.counts * grids_[p].Coverage() * LayerFactor(light, fit, fit.layers.depth_mm[l], fit.layers.sigma_mm[l]);
    }
    if (known_) photons += known_->LayerPhotons(l);
    fit.layers.weight[l] = photons / exposure;
    most = std::max(most, fit.layers.weight[l]);
  }
  for (double& w : fit.layers.weight)
    if (w < 1e-12 * most) w = 0.0;
}

ProfileFit Sweeps(const ReferenceEm& em, ProfileFit fit, const EmOptions& options) {
  fit.iterations = 0;
  double before = 0.0;
  while (fit.iterations < options.max_iterations) {
    ProfileFit next = em.Sweep(fit, &before);
    const double now = em.Objective(next);
    next.iterations = fit.iterations + 1;
    fit = std::move(next);
    if (before - now < options.tolerance * std::abs(before)) break;
  }
  fit.divergence = em.Divergence(fit);
  return fit;
}

}  // namespace

ProfileFit FitReference(std::span<const ProfileLight> lights, const LayerSet& start, const EmOptions& options) {
  const ReferenceEm em(lights, options);
  return Sweeps(em, em.Start(start), options);
}

ProfileFit RefineReference(std::span<const ProfileLight> lights, const ProfileFit& start, const EmOptions& options) {
  ReferenceEm em(lights, options);
  if (options.prior.photons > 0.0) em.SetPrior(start);
  return Sweeps(em, start, options);
}

double PenalisedDivergence(std::span<const ProfileLight> lights, const ProfileFit& centre, const ProfileFit& fit,
                           const EmOptions& options) {
  ReferenceEm em(lights, options);
  if (options.prior.photons > 0.0) em.SetPrior(centre);
  return em.Objective(fit);
}

}  // namespace stratalux::fit
