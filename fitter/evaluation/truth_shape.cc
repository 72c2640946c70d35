// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/truth_shape.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "fitter/sensor/linear_frame.h"
#include "fitter/stages/lit_quads.h"

namespace stratalux::fit {
namespace {

// Whatever the light does not truly reach is shadow.
Image<QuadLight> LightOf(const Image<uint8_t>& reached) {
  Image<QuadLight> light(reached.width(), reached.height());
  std::ranges::transform(reached.pixels(), light.pixels().begin(),
                         [](uint8_t r) { return r != 0 ? QuadLight::kLit : QuadLight::kShadow; });
  return light;
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
    shape.lit.push_back(AwayFromShadow(LightOf(light)));
    shape.code_weights.emplace_back(width, height);
  }
  return shape;
}

}  // namespace stratalux::fit
