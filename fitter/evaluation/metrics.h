// SPDX-License-Identifier: Apache-2.0
// metrics.json, schema 2 (model section 9; docs/math/evaluation.md).
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "fitter/evaluation/image_error.h"
#include "fitter/evaluation/interval_figures.h"
#include "fitter/evaluation/normal_error.h"
#include "fitter/evaluation/surface_error.h"
#include "fitter/mixture/srd_centroid.h"
#include "fitter/mixture/surface_offset.h"
#include "fitter/motion/head_motion.h"
#include "fitter/reconstruction/drift.h"
#include "fitter/stages/fit_summary.h"
#include "fitter/stages/srd.h"

namespace stratalux::fit {

struct HeldOutFigure {
  int projector = 0;
  std::string light;  // stripe | white | spot
  std::string model;  // tied | free | homogeneous | homogeneous_local_albedo | direction_blind |
                      // direction_blind_placed | dipole | an ablation
  std::string part;   // total | subsurface
  // total: the separated direct light, or the model's own prediction of the surface's; subsurface: against the truth of
  // a simulation, or the captured light less the separated direct one.
  std::string direct;    // separated | predicted | truth
  std::string geometry;  // reconstructed | truth
  int pool = 1;          // quads per side that one fitted profile covers
  int takes = 1;         // of the light that is compared with: their mean
  ImageError error;
  // Of error.nrmse, what the noise of that mean makes up, in quadrature: by half the difference of the takes (of one
  // take: as the next), and by the camera's noise model. 0 for the truth of a simulation.
  double noise_nrmse = 0.0;
  double camera_noise_nrmse = 0.0;
  // What is left of it: the error against the same light without noise.
  [[nodiscard]] double WithoutNoise() const;
};

// Which quads were judged, of those that could have been. With a truth, of the skin that the light truly reaches; else
// of the reconstructed surface.
struct Coverage {
  int projector = 0;
  std::string geometry;
  int64_t lit_skin = 0;  // truly lit skin; 0: no truth
  int64_t judged = 0;
  // Not judged, because ...
  int64_t no_surface = 0, unlit = 0, not_fitted = 0;
  // Fitted and taken for lit, but not judged: hair, eyes or anything else; skin that the light does not truly reach;
  // skin whose direct light its sinusoids did not tell (SeparationReason), where they told any.
  int64_t not_skin = 0, in_shadow = 0, not_separated = 0;
  // Of the judged fit, total, over what it predicts and is not judged; by light.
  std::map<std::string, double> left_out_nrmse;
  // Who says what is skin: truth, the mask of the skin stage, or none (all of the surface is).
  std::string skin_by = {};
};

struct CentroidFigure {
  int projector = 0;
  std::string geometry;
  CentroidError error;
};

// How the surface of a fit was placed along the view (SurfaceOffset).
struct OffsetFigure {
  std::optional<int> heldout;  // none: by all projectors, as the fit's files have it
  std::string model;           // whose choice: the judged one's, or direction_blind_placed
  SurfaceOffset offset;
  std::optional<SurfaceError> truth;  // of the placed surface
};

// What the skin stage found, in quads of the reconstructed surface.
struct SkinFigure {
  int64_t surface = 0, skin = 0;
  bool told = false;                                 // else all of the surface counts as skin
  std::map<std::string, int64_t> surface_by_reason;  // SkinReason
  std::optional<MaskOverlap> truth;                  // against that of a simulation, stubble as skin
};

struct StageFigure {
  std::string name;
  double seconds = 0.0;
  double cpu_seconds = 0.0;  // of all threads
  int64_t peak_rss_bytes = 0;
};

struct Metrics {
  std::string session, fit, program_version, options_json;
  std::string evaluation;                        // first | held_out | full: what of it is in here
  std::string evaluation_key;                    // of the stages that were compared: other programs make other keys
  std::map<std::string, std::string> artifacts;  // stage -> key, of what the fit is made of
  std::vector<HeldOutFigure> heldout;
  std::vector<HeldOutFigure> ablations;  // and, beside each, the judged fit on the same mask
  std::vector<Coverage> coverage;
  IntervalFigures intervals;              // by the hold-outs on the fit's own surface
  std::vector<CentroidFigure> centroids;  // of the fitted model's held-out SRDs
  FitSummary summary;
  std::vector<SweepFigure> sweeps;
  std::vector<StageFigure> stages;
  DriftReport drift;  // of the rig since its calibration
  HeadMotion motion;  // of the visitor during the capture
  std::vector<OffsetFigure> offsets;
  SkinFigure skin;
  std::optional<SurfaceError> truth;     // of the fit's surface; only in simulation
  std::optional<SurfaceError> unplaced;  // the same before it was placed
  std::optional<NormalFigures> normals;  // the same of its normals

  [[nodiscard]] std::string ToJson() const;
};

}  // namespace stratalux::fit
