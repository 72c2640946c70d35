// SPDX-License-Identifier: Apache-2.0
#include "fitter/profiles/profile_em.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace stratalux::fit {
namespace {

constexpr double kTiny = 1e-12;
// Where the shared parameters may go. tau < 0: what narrow layers gain at oblique light can fall to it.
struct Range {
  double low, high;
  [[nodiscard]] double Clamp(double x) const { return std::clamp(x, low, high); }
};
constexpr Range kTau = {-2.0, 3.0}, kKappa = {-5.0, 20.0}, kSlope = {-2.0, 4.0}, kSigma0 = {0.02, 2.0};
// What the shared parameters are held to where the lights do not tell them apart (exits all alike, few incidences):
// about what Monte Carlo skins of three tones ask for when their lights do (docs/math/em.md).
struct Prior {
  double mean, deviation;
  // In units of the prior's weight.
  [[nodiscard]] double Cost(double x) const { return 0.5 * (x - mean) * (x - mean) / (deviation * deviation); }
};
constexpr Prior kTauPrior = {0.25, 0.25}, kKappaPrior = {0.5, 3.0}, kSlopePrior = {1.15, 0.2},
                kLogSigma0Prior = {-2.4, 0.35};
constexpr double kFreeReachMm = 8.0;  // of a mean in free mode

using Vector = std::vector<double>;

// Expected photons c of each layer in each light, and their moments about the layer's mean.
struct Expected {
  std::vector<Vector> c, cx, cxx;  // [light][layer], in photons
  explicit Expected(size_t lights, size_t layers) : c(lights, Vector(layers)), cx(c), cxx(c) {}
};

// Sums of a layer over all lights, about its old mean: c, c s x, c s^2, c x^2.
struct LayerSums {
  double photons = 0.0, moved = 0.0, leverage = 0.0, spread = 0.0;
};

class ProfileEm {
 public:
  ProfileEm(std::span<const ProfileLight> lights, const EmOptions& options, SharedParameters shared,
            double shared_prior)
      : options_(options), shared_(shared), shared_prior_(shared_prior) {
    for (const ProfileLight& light : lights) grids_.emplace_back(light);
    for (const ProfileLight& light : lights)
      for (double y : light.y) total_photons_ += light.counts * std::max(y + light.read_shift, 0.0);
    sigma_floor_ = options.min_sigma_mm;
    for (const FineGrid& grid : grids_) sigma_floor_ = std::max(sigma_floor_, 0.9 * grid.CellMm());
  }

  [[nodiscard]] ProfileFit Start(const LayerSet& layers) const;
  // One sweep; `objective_before` receives that of `fit`.
  [[nodiscard]] ProfileFit Sweep(const ProfileFit& fit, double* objective_before) const;
  // From x0 and two sweeps from it, the SQUAREM extrapolation; false where there is nothing to extrapolate.
  [[nodiscard]] bool Extrapolate(const ProfileFit& x0, const ProfileFit& x1, const ProfileFit& x2,
                                 ProfileFit& ahead) const;
  [[nodiscard]] double Divergence(const ProfileFit& fit) const;
  // What EM lowers: the divergence and what the shared parameters cost.
  [[nodiscard]] double Objective(const ProfileFit& fit) const;

 private:
  void UpdateFloor(ProfileFit& fit, size_t p, const Vector& ratio) const;
  void ShareBackground(ProfileFit& fit) const;
  void UpdateLayers(ProfileFit& fit, const Expected& expected) const;
  void UpdateShared(ProfileFit& fit, const Expected& expected) const;
  void UpdateWeights(ProfileFit& fit, const Expected& expected) const;
  [[nodiscard]] double PriorCost(const ProfileFit& fit) const;
  [[nodiscard]] double SharedGain(const ProfileFit& fit, const Expected& expected) const;
  [[nodiscard]] Vector Pack(const ProfileFit& fit) const;
  [[nodiscard]] ProfileFit Unpack(const Vector& x, const ProfileFit& like) const;

  EmOptions options_;
  SharedParameters shared_;
  double shared_prior_;
  std::vector<FineGrid> grids_;
  double sigma_floor_ = 0.0;
  double total_photons_ = 0.0;
};

ProfileFit ProfileEm::Start(const LayerSet& layers) const {
  ProfileFit fit;
  fit.layers = layers;
  fit.tau = options_.scattering.tau;
  fit.directional = options_.scattering.directional;
  if (shared_ == SharedParameters::kTauAndDirectional && fit.directional.Off())
    fit.directional = {0.0, 1.0, 0.1};  // about what skin asks for
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

double ProfileEm::PriorCost(const ProfileFit& fit) const {
  double cost = 0.0;
  if (shared_ == SharedParameters::kTauAndDirectional)
    cost = kKappaPrior.Cost(fit.directional.kappa_per_mm) + kSlopePrior.Cost(fit.directional.phase_slope) +
           kLogSigma0Prior.Cost(std::log(fit.directional.sigma_0_mm)) +
           (options_.scattering.gain_model ? kTauPrior.Cost(fit.tau) : 0.0);
  return shared_prior_ * cost;
}

double ProfileEm::Objective(const ProfileFit& fit) const { return Divergence(fit) + PriorCost(fit); }

double ProfileEm::Divergence(const ProfileFit& fit) const {
  double divergence = 0.0, total = 0.0;
  for (size_t p = 0; p < grids_.size(); ++p) {
    const Misfit misfit = MisfitOf(grids_[p].light(), ModelOf(fit, grids_[p], p));
    divergence += misfit.divergence;
    total += misfit.photons;
  }
  return total > 0.0 ? divergence / total : 0.0;
}

ProfileFit ProfileEm::Sweep(const ProfileFit& fit, double* objective_before) const {
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
  UpdateShared(next, expected);
  UpdateWeights(next, expected);
  *objective_before = (total > 0.0 ? divergence / total : 0.0) + PriorCost(fit);
  return next;
}

void ProfileEm::UpdateFloor(ProfileFit& fit, size_t p, const Vector& ratio) const {
  double own_ratio = 0.0, own = 0.0, mean = 0.0;
  for (size_t k = 0; k < ratio.size(); ++k) {
    own_ratio += ratio[k] * grids_[p].SurfaceResponse(static_cast<int>(k));
    own += grids_[p].SurfaceResponse(static_cast<int>(k));
    mean += ratio[k] / static_cast<double>(ratio.size());
  }
  if (grids_[p].light().reflected < 0.0) fit.surface[p] *= own_ratio / std::max(own, kTiny);
  fit.background[p] *= mean;
}

// One floor for all lights: the mean of theirs, weighted by the photons each would see of it.
void ProfileEm::ShareBackground(ProfileFit& fit) const {
  double photons = 0.0, exposure = 0.0;
  for (size_t p = 0; p < grids_.size(); ++p) {
    const double seen = grids_[p].light().counts * grids_[p].light().samples();
    photons += seen * fit.background[p];
    exposure += seen;
  }
  std::fill(fit.background.begin(), fit.background.end(), photons / exposure);
}

// d_l = sum_p s_p sum_z c z / sum_p s_p^2 sum_z c and sigma_l^2 = sum c (z - d_l s_p)^2 / sum c, with z = d_old s + x.
void ProfileEm::UpdateLayers(ProfileFit& fit, const Expected& expected) const {
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
void ProfileEm::UpdateWeights(ProfileFit& fit, const Expected& expected) const {
  double most = 0.0;
  for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
    double photons = 0.0, exposure = 0.0;
    for (size_t p = 0; p < grids_.size(); ++p) {
      const ProfileLight& light = grids_[p].light();
      photons += expected.c[p][l];
      exposure +=
          light.counts * grids_[p].Coverage() * LayerFactor(light, fit, fit.layers.depth_mm[l], fit.layers.sigma_mm[l]);
    }
    fit.layers.weight[l] = photons / exposure;
    most = std::max(most, fit.layers.weight[l]);
  }
  for (double& w : fit.layers.weight)
    if (w < 1e-12 * most) w = 0.0;
}

// The part of EM's lower bound that tau and the directional weights enter, the layers' weights at their best:
//   sum_lp c_lp log(g_p f_lp) - sum_l c_l log(sum_p n_p A_p g_p f_lp).
double ProfileEm::SharedGain(const ProfileFit& fit, const Expected& expected) const {
  double gain = 0.0;
  for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
    double photons = 0.0, exposure = 0.0;
    for (size_t p = 0; p < grids_.size(); ++p) {
      const ProfileLight& light = grids_[p].light();
      const double factor = LayerFactor(light, fit, fit.layers.depth_mm[l], fit.layers.sigma_mm[l]);
      photons += expected.c[p][l];
      exposure += light.counts * grids_[p].Coverage() * factor;
      gain += expected.c[p][l] * std::log(factor);
    }
    gain -= photons * std::log(exposure);
  }
  return gain - total_photons_ * PriorCost(fit);
}

// One step of each shared parameter to the vertex of the parabola through three values of the bound; a step that does
// not raise it is not taken, so the likelihood keeps rising.
void ProfileEm::UpdateShared(ProfileFit& fit, const Expected& expected) const {
  if (shared_ == SharedParameters::kFixed) return;
  struct Parameter {
    double* value;
    double step, low, high;
  };
  std::vector<Parameter> parameters;
  if (options_.scattering.gain_model) parameters.push_back({&fit.tau, 0.02, kTau.low, kTau.high});
  if (shared_ == SharedParameters::kTauAndDirectional) {
    parameters.push_back({&fit.directional.kappa_per_mm, 0.02, kKappa.low, kKappa.high});
    parameters.push_back({&fit.directional.phase_slope, 0.04, kSlope.low, kSlope.high});
    parameters.push_back({&fit.directional.sigma_0_mm, 0.02 * fit.directional.sigma_0_mm, kSigma0.low, kSigma0.high});
  }
  double best = SharedGain(fit, expected);
  for (const Parameter& p : parameters) {
    const double here = *p.value;
    auto at = [&](double value) {
      *p.value = std::clamp(value, p.low, p.high);
      return SharedGain(fit, expected);
    };
    const double below = at(here - p.step), above = at(here + p.step), bend = above - 2.0 * best + below;
    const double slope = 0.5 * (above - below);
    double move = bend < 0.0 ? -slope / bend : (slope > 0.0 ? 4.0 : -4.0);
    move = std::clamp(move, -8.0, 8.0);
    const double reached = at(here + move * p.step);
    if (reached > best) {
      best = reached;
    } else {
      *p.value = here;
    }
  }
}

// SQUAREM works in coordinates without bounds: logarithms of what is positive.
Vector ProfileEm::Pack(const ProfileFit& fit) const {
  Vector x;
  for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
    x.push_back(std::log(std::max(fit.layers.weight[l], 1e-15)));
    x.push_back(fit.layers.depth_mm[l]);
    x.push_back(std::log(fit.layers.sigma_mm[l]));
  }
  for (const Vector* terms : {&fit.surface, &fit.background})
    for (double v : *terms) x.push_back(std::log(std::max(v, 1e-15)));
  x.push_back(fit.tau);
  x.push_back(fit.directional.kappa_per_mm);
  x.push_back(fit.directional.phase_slope);
  x.push_back(std::log(std::max(fit.directional.sigma_0_mm, kSigma0.low)));
  return x;
}

ProfileFit ProfileEm::Unpack(const Vector& x, const ProfileFit& like) const {
  ProfileFit fit = like;
  size_t at = 0;
  for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
    const double w = std::exp(x[at]);
    fit.layers.weight[l] = like.layers.weight[l] > 0.0 ? w : 0.0;
    fit.layers.depth_mm[l] = options_.scattering.mode == FitMode::kFree
                                 ? std::clamp(x[at + 1], -kFreeReachMm, kFreeReachMm)
                                 : std::clamp(x[at + 1], options_.min_depth_mm, options_.max_depth_mm);
    fit.layers.sigma_mm[l] =
        std::clamp(std::exp(x[at + 2]), sigma_floor_, std::max(options_.max_sigma_mm, sigma_floor_));
    at += 3;
  }
  for (Vector* terms : {&fit.surface, &fit.background})
    for (double& v : *terms) v = v > 0.0 ? std::exp(x[at++]) : (++at, 0.0);
  if (shared_ == SharedParameters::kFixed) return fit;
  fit.tau = kTau.Clamp(x[at]);
  if (shared_ != SharedParameters::kTauAndDirectional) return fit;
  fit.directional.kappa_per_mm = kKappa.Clamp(x[at + 1]);
  fit.directional.phase_slope = kSlope.Clamp(x[at + 2]);
  fit.directional.sigma_0_mm = kSigma0.Clamp(std::exp(x[at + 3]));
  return fit;
}

// Varadhan & Roland 2008, scheme S3: x' = x0 - 2 a r + a^2 v, r = x1 - x0, v = x2 - 2 x1 + x0, a = -|r| / |v|.
bool ProfileEm::Extrapolate(const ProfileFit& x0, const ProfileFit& x1, const ProfileFit& x2, ProfileFit& ahead) const {
  const Vector a = Pack(x0), b = Pack(x1), c = Pack(x2);
  double rr = 0.0, vv = 0.0;
  for (size_t i = 0; i < a.size(); ++i) {
    rr += (b[i] - a[i]) * (b[i] - a[i]);
    vv += (c[i] - 2.0 * b[i] + a[i]) * (c[i] - 2.0 * b[i] + a[i]);
  }
  if (!(vv > 0.0)) return false;
  const double alpha = std::max(-std::sqrt(rr / vv), -64.0);
  if (alpha > -1.0) return false;
  Vector x(a.size());
  for (size_t i = 0; i < a.size(); ++i) {
    const double r = b[i] - a[i], v = c[i] - 2.0 * b[i] + a[i];
    x[i] = a[i] - 2.0 * alpha * r + alpha * alpha * v;
  }
  ahead = Unpack(x, x2);
  return true;
}

}  // namespace

ProfileFit RunProfileEm(std::span<const ProfileLight> lights, const LayerSet& start, const EmOptions& options,
                        SharedParameters shared, double shared_prior) {
  const ProfileEm em(lights, options, shared, shared_prior);
  ProfileFit fit = em.Start(start);
  double before = 0.0, ignored = 0.0;
  constexpr int kSweeps = 3;  // a round
  while (fit.iterations < options.max_iterations) {
    const ProfileFit first = em.Sweep(fit, &before);
    ProfileFit next = em.Sweep(first, &ignored);
    double now = em.Objective(next);
    if (ProfileFit ahead; em.Extrapolate(fit, first, next, ahead)) {
      // A sweep from the extrapolated point steadies it; it is kept only where it beats the plain sweeps.
      ahead = em.Sweep(ahead, &ignored);
      if (const double there = em.Objective(ahead); there < now) {
        next = std::move(ahead);
        now = there;
      }
    }
    next.iterations = fit.iterations + kSweeps;
    fit = std::move(next);
    if (before - now <= kSweeps * options.tolerance * std::abs(before)) break;
  }
  fit.divergence = em.Divergence(fit);
  return fit;
}

}  // namespace stratalux::fit
