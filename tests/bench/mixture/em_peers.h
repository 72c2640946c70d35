// SPDX-License-Identifier: Apache-2.0
// Gaussian mixtures of others on the same profiles. They take no weights: each sample is repeated as often as it has
// photons. scikit-learn's stands in em_sklearn.py.
#pragma once

#include <vector>

#include "fitter/mixture/mixture_map.h"
#include "tests/bench/mixture/peer_profiles.h"

namespace stratalux::bench {

// A place in mm for each photon, spread over the cell: many samples at one place would be a layer without width.
[[nodiscard]] std::vector<double> RepeatedSamples(const Photons& photons);

// At most `sweeps` iterations of diagonal covariances from `start`; from the peer's own k-means where that is empty.
// depth_mm are the means.
using PeerEm = fit::LayerSet (*)(const Photons& photons, const fit::LayerSet& start, int layers, int sweeps);

// cv::ml::EM.
[[nodiscard]] fit::LayerSet OpencvEm(const Photons& photons, const fit::LayerSet& start, int layers, int sweeps);

// arma::gmm_diag, ten iterations of k-means; nullptr where built without Armadillo.
[[nodiscard]] PeerEm ArmadilloEm();

}  // namespace stratalux::bench
