// SPDX-License-Identifier: Apache-2.0
// The prior of MAP EM in plain double precision (docs/math/em.md, "The prior"): N0 photons of a known pixel, seen
// beside the profile's own.
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/profile_fit.h"

namespace stratalux::fit {

// Photons that a fit shows of each layer, and of surface (0 where it is known) and floor of each light.
struct ShownPhotons {
  std::vector<double> layers, surface, background;
  [[nodiscard]] double Sum() const;
};
[[nodiscard]] ShownPhotons ShownBy(const ProfileFit& fit, std::span<const FineGrid> grids);

// Sums of a layer over all lights, about its old mean: c, c s x, c s^2, c x^2.
struct LayerSums {
  double photons = 0.0, moved = 0.0, leverage = 0.0, spread = 0.0;
};

class KnownPixel {
 public:
  // `grids` must outlive it.
  KnownPixel(const ProfileFit& fit, std::span<const FineGrid> grids, const EmOptions& options);

  // N0 times the Kullback-Leibler divergence of the known pixel's complete data (which component each photon is of, and
  // where it left) from those of `fit`.
  [[nodiscard]] double Cost(const ProfileFit& fit) const;

  [[nodiscard]] double LayerPhotons(size_t layer) const { return photons_.layers[layer]; }
  void AddLayer(size_t layer, double old_depth_mm, LayerSums& sums) const;
  void AddFloor(size_t light, ProfileFit& fit) const;
  // The prior is one of shape: `fit`, made of C + N0 photons, shows C.
  void KeepTotal(ProfileFit& fit) const;

 private:
  ProfileFit fit_;
  std::span<const FineGrid> grids_;
  double n0_, square_shift_;
  ShownPhotons photons_;  // they add up to N0
};

}  // namespace stratalux::fit
