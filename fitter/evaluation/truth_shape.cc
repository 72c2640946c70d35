// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/truth_shape.h"

#include <cmath>
#include <string>

#include "fitter/sensor/linear_frame.h"

namespace stratalux::fit {
namespace {

Image<uint8_t> AwayFromDark(const Image<uint8_t>& light) {
  Image<uint8_t> lit(light.width(), light.height());
  for (int j = 1; j + 1 < light.height(); ++j)
    for (int i = 1; i + 1 < light.width(); ++i) {
      bool inside = true;
      for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x) inside = inside && light(i + x, j + y) != 0;
      lit(i, j) = inside ? 1 : 0;
    }
  return lit;
}

}  // namespace

Result<FaceShape> TruthShape(const SceneTruth& truth, const FaceShape& reconstructed, const RigCalibration& record) {
  FaceShape shape = reconstructed;
  shape.record = truth.exact_calibration().value_or(record);
  SLX_ASSIGN_OR_RETURN(shape.surface, truth.Surface(LinearRig(shape.record)));
  return shape;
}

Result<FaceShape> TruthShapeAlone(const SceneTruth& truth, const RigCalibration& record) {
  FaceShape shape;
  SLX_ASSIGN_OR_RETURN(shape, TruthShape(truth, shape, record));
  const int width = shape.surface.width(), height = shape.surface.height();
  shape.disagreement_mm = Image<float>(width, height, 1, std::nanf(""));
  for (size_t p = 0; p < shape.record.projectors.size(); ++p) {
    SLX_ASSIGN_OR_RETURN(const auto light, truth.LitBy(static_cast<int>(p)));
    if (light.width() != width || light.height() != height)
      return Status::NotFound("truth.seg says nothing of the direct light of projector " + std::to_string(p) +
                              ": capture the simulated visitor again");
    shape.lit.push_back(AwayFromDark(light));
    shape.code_weights.emplace_back(width, height);
  }
  return shape;
}

}  // namespace stratalux::fit
