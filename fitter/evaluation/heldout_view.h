// SPDX-License-Identifier: Apache-2.0
// The reconstructed surface under the held-out projector's lights: what the predictions of all models, and their
// comparison, have in common.
#pragma once

#include <string>
#include <vector>

#include "fitter/render/lit_surface.h"
#include "fitter/stages/shape.h"
#include "shared/capture/plan.h"

namespace stratalux::fit {

struct HeldOutView {
  FaceShape shape;
  RigCalibration rig;  // the record's, linear (LinearRig)
  int projector = 0;
  double exposure_ms = 0.0, separation_period = 8.0;  // of the plan
  std::vector<std::string> lights;
  LitSurface lit;
  std::vector<LitPyramid> pyramids;      // of each light's pattern, less the projector's black
  std::vector<Image<float>> irradiance;  // SurfaceIrradiance under each of them
};

// `projector`: of shape.record; `lights`: names that HeldOutPattern knows.
[[nodiscard]] HeldOutView ViewOf(FaceShape shape, const PlanOptions& plan, int projector,
                                 const std::vector<std::string>& lights);

}  // namespace stratalux::fit
