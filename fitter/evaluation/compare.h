// SPDX-License-Identifier: Apache-2.0
// The compare stage: what several models predict of the held-out projector's lights, against what was captured. One
// target, one direct image and one mask for all of them (docs/math/evaluation.md).
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "fitter/evaluation/interval_figures.h"
#include "fitter/evaluation/metrics.h"
#include "fitter/evaluation/predict.h"
#include "fitter/evaluation/truth.h"
#include "fitter/separation/separation_map.h"
#include "fitter/session/session_frames.h"
#include "fitter/skin/skin_mask.h"

namespace stratalux::fit {

inline constexpr int kCompareVersion = 15;

struct ComparedModel {
  std::string name;  // the first one is the fit that is judged
  Prediction prediction;
};

struct CompareInput {
  const SessionFrames& frames;  // read by the view's record
  const HeldOutView& view;
  const SeparationMap& separation;  // of the projector, as captured
  const std::optional<SceneTruth>& truth;
  const SkinMask& skin;  // on the shape's quads: what is judged where the truth does not say what is skin
  int pool = 1;
  std::string geometry;  // reconstructed | truth
};

// What the report shows of one light; quads, digital numbers above black.
struct LightComparison {
  std::string light;      // stripe | white | spot
  Image<float> measured;  // mean of the takes
  Image<float> direct;    // separated direct light under the pattern, less the first model's share of it; none: its own
  Image<float> subsurface;         // of the first model
  Image<float> total;              // subsurface + direct
  Image<float> total_homogeneous;  // of the model of that name; empty where it is none of them
};

struct Comparison {
  std::vector<HeldOutFigure> figures;
  Coverage coverage;
  std::vector<LightComparison> pictures;
  HeldOutErrors errors;  // of the first model, its own surface light predicted, too
};

// Figures are NaN, of 0 pixels, where the models have none in common that the light reaches.
[[nodiscard]] Result<Comparison> CompareHeldOut(const CompareInput& input, const std::vector<ComparedModel>& models);

// compare.json, the pictures as <light>_*.exr, errors.npy.
Status SaveComparison(const std::filesystem::path& folder, const Comparison& comparison);
[[nodiscard]] Result<Comparison> LoadComparison(const std::filesystem::path& folder);

}  // namespace stratalux::fit
