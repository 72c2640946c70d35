// SPDX-License-Identifier: Apache-2.0
// Direction dependence of the held-out light (model section 9): where an SRD's centroid lies, measured and predicted.
#pragma once

#include <cstdint>

#include "fitter/mixture/fit_mixture.h"

namespace stratalux::fit {

struct CentroidError {
  // Least-squares slopes of the centroid over the profile's shift coefficient s: mm per mm of depth shift. A surface
  // reconstructed from displaced codes hides the measured one; a direction-blind fit predicts 0.
  double measured_mm = 0.0, predicted_mm = 0.0;
  double rms_mm = 0.0;  // of predicted minus measured, noise of single profiles included
  int64_t profiles = 0;
};

// Centroids of the samples within `reach_mm` of the line, of one fitted profile in `every`; `heldout` is the light of
// `projector` (UnlayeredOf: its surface and floor).
[[nodiscard]] CentroidError CompareCentroids(const MixtureMap& map, const SrdBatch& heldout, int projector,
                                             double reach_mm = 2.0, int every = 16);

}  // namespace stratalux::fit
