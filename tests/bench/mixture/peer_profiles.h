// SPDX-License-Identifier: Apache-2.0
// The profiles that own and other Gaussian mixtures are compared on, and the measure of their fits.
#pragma once

#include <string>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/srd_samples.h"
#include "tests/fitter/mixture/em_cases.h"

namespace stratalux::bench {

inline constexpr int kPeerProfiles = 16, kPeerLayers = 20, kPeerSweeps = 50;
inline constexpr double kPeerPhotons = 5000.0;  // of a profile

// One light's profile as a textbook, or a peer, wants it: photons in cells centred at first_mm + i step_mm.
struct Photons {
  std::vector<double> at;
  double first_mm = 0.0, step_mm = 0.0;
};
// Each sample shared out to `per_sample` cells, the sum made `total`.
[[nodiscard]] Photons PhotonsOf(const fit::SrdBatch& batch, int64_t profile, int per_sample, double total);

// Kullback-Leibler divergence of a normalised mixture (depth_mm: the means), integrated over each cell, from a profile,
// as [M 6] compares them.
[[nodiscard]] double DivergenceOf(const Photons& photons, const fit::LayerSet& layers);

// Profiles of one light as a peer can fit them, each on its own with free means: photons alone, as far from the entry
// point as free means may go, and nothing but the step's width between layers and samples.
struct PeerProfiles {
  fit::SrdBatch noisy;
  fit::SrdBatch truth;  // the first kPeerProfiles without noise: a mixture that follows the noise is not the better one
};
[[nodiscard]] PeerProfiles MakePeerProfiles(const fit::EmCases& skins);

// Own fit of them: free means, no gain, surface or background; `sweeps` of them whatever they gain.
[[nodiscard]] fit::EmOptions PeerOptions(int sweeps);

// The layers that own EM starts from, weights of sum 1.
[[nodiscard]] fit::LayerSet OwnStart(const fit::SrdBatch& noisy, int profile);

// The first kPeerProfiles for peers in other languages (em_sklearn.py), three lines each, words apart by spaces:
//   noisy FIRST_MM STEP_MM PHOTONS...    truth FIRST_MM STEP_MM PHOTONS...    start (WEIGHT MEAN_MM SIGMA_MM)...
// False where the file cannot be written.
[[nodiscard]] bool WritePeerProfiles(const PeerProfiles& profiles, const std::string& path);

}  // namespace stratalux::bench
