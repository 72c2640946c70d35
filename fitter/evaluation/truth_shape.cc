// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/truth_shape.h"

#include "fitter/sensor/linear_frame.h"

namespace stratalux::fit {

Result<FaceShape> TruthShape(const SceneTruth& truth, const FaceShape& reconstructed, const RigCalibration& record) {
  FaceShape shape = reconstructed;
  shape.record = truth.exact_calibration().value_or(record);
  SLX_ASSIGN_OR_RETURN(shape.surface, truth.Surface(LinearRig(shape.record)));
  return shape;
}

}  // namespace stratalux::fit
