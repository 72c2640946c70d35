// SPDX-License-Identifier: Apache-2.0
// All stages of one session, from frames to report: `stratalux-fit run`.
#pragma once

#include <filesystem>
#include <string>

#include "fitter/mixture/em_options.h"
#include "fitter/pipeline/fit_stage.h"
#include "fitter/pipeline/holdout.h"
#include "fitter/pipeline/layer_maps.h"
#include "shared/base/log.h"

namespace stratalux::fit {

enum class Stage { kDecode, kReconstruct, kSeparate, kNormals, kSrd, kFit, kRender, kEvaluate, kReport };
[[nodiscard]] const char* ToString(Stage stage);
[[nodiscard]] Result<Stage> ParseStage(const std::string& text);

enum class GeometrySource { kReconstructed, kTruth };

struct RunOptions {
  std::string store;
  std::string session = "latest";
  EmOptions em;
  int heldout = 3;               // the projector left out of the full-size fit
  SrdOptions srd;                // pool: quads per side of that fit's profiles
  bool full_evaluation = false;  // every projector held out in turn; baselines, ablations, true geometry
  bool standard_errors = false;  // maps of them, too: about as long again as a fit from scratch
  GeometrySource geometry = GeometrySource::kReconstructed;
  Stage until = Stage::kReport;
  bool force = false;  // again, even if this fit is complete
  [[nodiscard]] Status Validate() const;
  [[nodiscard]] std::string ToJson() const;
};

struct RunOutcome {
  std::string session, fit;
  std::filesystem::path folder;  // STORE/sessions/<id>/fits/<fit>
  bool was_complete = false;     // nothing had to be done
  Metrics metrics;
};

// Everything the report shows.
struct RunPictures {
  const SessionFrames* frames = nullptr;
  const FaceGeometry* face = nullptr;
  const SurfaceMap* surface = nullptr;
  int64_t chosen_profile = -1;        // whose SRDs are shown; -1: none
  std::vector<SrdBatch> chosen_srds;  // of that profile alone, by projector
  LayerMaps layer_maps;
  Image<float> signal_to_noise;
  const MixtureMap* map = nullptr;
  std::vector<LightComparison> comparisons;
  std::vector<LightComparison> homogeneous;  // figure 9 d
  int heldout = 0;
};

Result<RunOutcome> RunSession(const RunOptions& options, Logger& logger);

// Folder of the session's newest complete fit; kNotFound when there is none.
[[nodiscard]] Result<std::filesystem::path> NewestFit(const std::string& store, const std::string& session);

// Chooses the pixel whose SRDs the report shows and copies them: the set itself need not live so long.
void ShowLayers(const MixtureMap& map, const SrdSet& srds, RunPictures& pictures);

// Writes report/index.html into `folder`.
Status WriteReport(const std::filesystem::path& folder, const RunPictures& pictures, const Metrics& metrics);

}  // namespace stratalux::fit
