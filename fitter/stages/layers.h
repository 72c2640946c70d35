// SPDX-License-Identifier: Apache-2.0
// The fit stage (layers): the layers of every pixel by EM, and what all pixels of a session share, on the training
// lights alone.
#pragma once

#include <string>
#include <vector>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/stages/srd.h"
#include "shared/base/log.h"

namespace stratalux::fit {

inline constexpr int kFitVersion = 1;

// All of them that FitLayers reads, as JSON: what the fit's key holds.
[[nodiscard]] std::string EmOptionsJson(const EmOptions& options);

// The batches of all projectors but one, their row sweeps after their column sweeps; kUsage when none is left.
// `projectors`: of each batch.
[[nodiscard]] Result<std::vector<const SrdBatch*>> TrainingLights(const SrdSet& srds, int heldout,
                                                                  std::vector<int>* projectors);

// EM on the training lights; options.mode says whether tied or free. First, as `options` ask for it: the reflection of
// the very surface, tau, directional weights, and the prior with the mean layers that it is centred on.
[[nodiscard]] Result<MixtureMap> FitLayers(const SrdSet& srds, int heldout, EmOptions options, Logger& logger,
                                           const std::string& label);

}  // namespace stratalux::fit
