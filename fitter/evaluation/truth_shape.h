// SPDX-License-Identifier: Apache-2.0
// The truth_shape stage: of the truth of a simulation an ordinary shape, for the runs that separate errors of the
// geometry from those of the model. No other stage of a fit may open truth.seg.
#pragma once

#include "fitter/evaluation/truth.h"
#include "fitter/stages/shape.h"

namespace stratalux::fit {

inline constexpr int kTruthShapeVersion = 7;

// `reconstructed`: of the same session; which quads a projector lights stays as its codes say. `record`: the session's.
[[nodiscard]] Result<FaceShape> TruthShape(const SceneTruth& truth, const FaceShape& reconstructed,
                                           const RigCalibration& record);

// The same where nothing was decoded: what is lit is the truth's word, too, one quad off any shadow's edge as LitQuads
// has it; no code has a weight, and nothing is known of a drift. kNotFound: a truth without direct light.
[[nodiscard]] Result<FaceShape> TruthShapeAlone(const SceneTruth& truth, const RigCalibration& record);

}  // namespace stratalux::fit
