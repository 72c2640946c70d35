// SPDX-License-Identifier: Apache-2.0
// The layers that many profiles have in common: what single ones start from, and what their prior is centred on.
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/layer_set.h"
#include "fitter/mixture/srd_samples.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// How many pixels tell.
inline constexpr int64_t kPixelsOfMean = 1000;

// One set of layers a channel, fitted to some `pixels` of those lit and not apart, evenly chosen, all together, each in
// its own brightness (docs/math/em.md, "Mean layers"). Weights are those of the mean brightness. Empty where a channel
// has no usable profile. Same input, same bits, whatever the number of threads. `start`: layers that are known to be
// near, by channel, such as those of the same pixels on a surface that lies a little deeper.
Result<std::vector<LayerSet>> MeanLayers(std::span<const SrdBatch* const> lights, int channels,
                                         const EmOptions& options, int64_t pixels = kPixelsOfMean,
                                         std::span<const LayerSet> start = {});

}  // namespace stratalux::fit
