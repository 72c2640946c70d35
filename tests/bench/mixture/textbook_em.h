// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "fitter/mixture/mixture_map.h"

namespace stratalux::bench {

// Weighted EM of a Gaussian mixture as a textbook has it: double precision, std::exp, responsibilities in a matrix.
// `photons` at positions first + i step. Changes `layers` (depth_mm: the means).
void TextbookEm(const std::vector<double>& photons, double first, double step, int sweeps, fit::LayerSet& layers);

}  // namespace stratalux::bench
