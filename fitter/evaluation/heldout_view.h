// SPDX-License-Identifier: Apache-2.0
// The reconstructed surface under the held-out projector's lights: what the predictions of all models, and their
// comparison, have in common.
#pragma once

#include <string>
#include <vector>

#include "fitter/render/lit_surface.h"
#include "fitter/separation/separation_map.h"
#include "fitter/stages/shape.h"
#include "shared/capture/plan.h"
#include "shared/geometry/rigid3.h"

namespace stratalux::fit {

struct HeldOutView {
  FaceShape shape;     // surface and what is lit, as they were while the projector shone
  Image<float> home;   // MovedSurface::home; empty: as the shape that it was made of
  RigCalibration rig;  // the record's, linear (LinearRig)
  int projector = 0;
  double exposure_ms = 0.0, separation_period = 8.0;  // of the plan
  // Of a head that moved: view to the moment of the projector's sinusoids, and the rig as it then stood to the head.
  Rigid3 to_separation;
  RigCalibration separation_rig;
  std::vector<std::string> lights;
  LitSurface lit;
  std::vector<LitPyramid> pyramids;      // of each light's pattern, less the projector's black
  std::vector<Image<float>> irradiance;  // SurfaceIrradiance under each of them
};

// Of a head that moved: on the quads of the projector's own moment, where its frames were captured. `projector`: of
// shape.record; `lights`: names that HeldOutPattern knows.
[[nodiscard]] HeldOutView ViewOf(FaceShape shape, const PlanOptions& plan, int projector,
                                 const std::vector<std::string>& lights);

// Of a mask on the shape's quads, on the view's.
[[nodiscard]] Image<uint8_t> OnView(const HeldOutView& view, const Image<uint8_t>& mask);
// Of what was separated of the projector's light (where it was captured), on the view's.
[[nodiscard]] SeparationMap OnView(const HeldOutView& view, const SeparationMap& separation);
// By profile of the view: which one of the shape's it is, -1: none; empty: its own.
[[nodiscard]] std::vector<int64_t> ProfilesOnView(const HeldOutView& view, int pool, int channels);

}  // namespace stratalux::fit
