// SPDX-License-Identifier: Apache-2.0
// Baselines that the layered, direction-aware fit must beat (model section 9).
#pragma once

#include <cstdint>
#include <span>

#include "fitter/mixture/fit_mixture.h"

namespace stratalux::fit {

// `apart`, here and below: as SrdBatch::apart, of the map's profiles. What is no skin has no part in a mean of skin.

// Figure 9 d: every pixel gets the mean weight, depth and width of each layer of its channel.
[[nodiscard]] MixtureMap Homogeneous(const MixtureMap& map, std::span<const uint8_t> apart = {});
// Mean shape, but each pixel's own total weight (the harder baseline).
[[nodiscard]] MixtureMap HomogeneousLocalAlbedo(const MixtureMap& map, std::span<const uint8_t> apart = {});

// Jensen et al. 2001: a half-space by a dipole of diffusion sources.
struct Dipole {
  double sigma_s_prime_per_mm = 1.0;
  double sigma_a_per_mm = 0.05;
  double eta = 1.4;
  [[nodiscard]] double RadialReflectance(double r_mm) const;  // R_d(r), 1 / mm^2
  [[nodiscard]] double LineSpread(double x_mm) const;         // integral of R_d along a line, 1 / mm
  [[nodiscard]] double TotalReflectance() const;              // closed form
};

// Dipole whose line spread fits the mean profile of the valid profiles of `channel` that are not apart best (least
// squares over both coefficients). `surface`: mean reflectance of the surface itself, whose spike is no dipole's and is
// taken off first.
[[nodiscard]] Dipole FitDipole(std::span<const SrdBatch* const> lights, int channel, int channels, double eta,
                               double surface);
// Mean surface term of the map's fitted profiles of a channel, over its training lights.
[[nodiscard]] double MeanSurfaceReflectance(const MixtureMap& map, int channel, std::span<const uint8_t> apart = {});
// The map's pixels with the dipole of their channel, scaled to their own total weight: a sum of centred Gaussians
// fitted to the dipole's line spread, so that the same renderer shows it.
[[nodiscard]] Result<MixtureMap> DipoleMap(const MixtureMap& map, std::span<const Dipole> dipoles);

}  // namespace stratalux::fit
