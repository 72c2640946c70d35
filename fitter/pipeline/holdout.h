// SPDX-License-Identifier: Apache-2.0
// Leave one projector out (model section 9): predict its light from layers that were fitted on the others, compare.
#pragma once

#include <string>
#include <vector>

#include "fitter/evaluation/metrics.h"
#include "fitter/evaluation/truth.h"
#include "fitter/pipeline/geometry_stage.h"
#include "fitter/render/mlsss.h"

namespace stratalux::fit {

// What is compared under one light of the held-out projector.
struct LightComparison {
  std::string light;        // stripe | white | spot
  Image<float> measured;    // quads, digital numbers above black
  Image<float> subsurface;  // rendered, tied model
  Image<float>
      surface_measured;  // the held-out light's measured direct part, without the model's narrow subsurface light
  Image<float> surface_rendered;  // mean surface term of the training lights
  Image<float> total;             // subsurface + surface_measured
};

struct HoldOutInput {
  const SessionFrames& frames;
  const FaceGeometry& face;
  const SurfaceMap& surface;  // that the SRDs were extracted on
  const std::optional<SceneTruth>& truth;
  int projector = 0;
  int pool = 1;
  std::string geometry = "reconstructed";
};

struct ModelToCompare {
  std::string name;
  const MixtureMap* map;
};

// Renders every model under the given lights and appends the figures. Returns the pictures of the first model.
[[nodiscard]] Result<std::vector<LightComparison>> CompareHeldOut(const HoldOutInput& input,
                                                                  const std::vector<ModelToCompare>& models,
                                                                  const std::vector<std::string>& lights,
                                                                  std::vector<HeldOutFigure>& figures);

}  // namespace stratalux::fit
