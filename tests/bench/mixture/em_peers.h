// SPDX-License-Identifier: Apache-2.0
// Gaussian mixtures of others on the same profiles. They take no weights: each sample is repeated as often as it has
// photons. Armadillo's gmm_diag and scikit-learn are not among Debian's packages that the project installs.
#pragma once

#include <vector>

#include "fitter/mixture/mixture_map.h"

namespace stratalux::bench {

// cv::ml::EM, diagonal covariances, k-means start, at most `sweeps` iterations; depth_mm are the means.
fit::LayerSet OpencvEm(const std::vector<double>& photons, double first, double step, int layers, int sweeps);

}  // namespace stratalux::bench
