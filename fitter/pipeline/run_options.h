// SPDX-License-Identifier: Apache-2.0
// What a user may choose of a run.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "fitter/srd/srd_extractor.h"
#include "fitter/stages/layers.h"

namespace stratalux::fit {

// Stages that a user can ask for by name; kReport: a whole fit.
enum class Stage { kReconstruct, kSeparate, kNormals, kSkin, kSrd, kFit, kMaps, kReport };

enum class GeometrySource { kReconstructed, kTruth };
[[nodiscard]] const char* ToString(GeometrySource source);

struct RunOptions {
  std::string store;
  std::string session = "latest";
  FitOptions fit;
  int heldout = 3;               // the projector left out of the full-size fit
  SrdOptions srd;                // pool: quads per side of that fit's profiles
  bool full_evaluation = false;  // every projector held out in turn; ablations, true geometry
  bool offset = true;            // of the reconstructed surface along the view, found and put right
  bool motion = true;            // of the head, found and made up for
  bool maps = true;              // from all projectors, too; not of a free fit: MakesMaps()
  bool standard_errors = false;  // maps of them, too, and the fits that leave out each projector
  GeometrySource geometry = GeometrySource::kReconstructed;
  // As if a shorter visit had been captured: at most so many of its frames (shared/capture/thin_plan.h). Comparisons
  // with held-out light and the report still read all of them.
  std::optional<int> frames = {};
  Stage until = Stage::kReport;
  bool dry_run = false;
  // Of the lease under which a queue's worker runs (db/catalogue/job_store.h): the fit is entered only while it stands,
  // and once, with its evaluation.
  std::optional<int64_t> job_token = {};
  [[nodiscard]] bool MakesMaps() const;
  [[nodiscard]] Status Validate() const;
  [[nodiscard]] std::string ToJson() const;
};

}  // namespace stratalux::fit
