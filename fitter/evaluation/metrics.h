// SPDX-License-Identifier: Apache-2.0
// metrics.json, schema 1 (model section 9; docs/math/evaluation.md).
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "fitter/calibration/drift.h"
#include "fitter/evaluation/image_error.h"
#include "fitter/evaluation/srd_centroid.h"

namespace stratalux::fit {

struct HeldOutFigure {
  int projector = 0;
  std::string light;     // stripe | white | spot
  std::string model;     // tied | free | homogeneous | homogeneous_local_albedo | direction_blind | dipole
  std::string part;      // total | subsurface
  std::string direct;    // measured | rendered | none
  std::string geometry;  // reconstructed | truth
  int pool = 1;          // quads per side that one fitted profile covers
  ImageError error;
  // Of error.nrmse, what the noise of the frame that is compared with makes up, in quadrature; 0 for the truth of a
  // simulation.
  double noise_nrmse = 0.0;
  // What is left of it: the error against the same frame without noise.
  [[nodiscard]] double AboveNoise() const;
};

struct AblationFigure {
  std::string name;  // projectors_permuted | comb_frames_shuffled
  int projector = 0;
  std::string light;
  std::string part;  // total (with the measured direct light) | subsurface
  double nrmse = 0.0;
  double baseline_nrmse = 0.0;  // the same fit, not ablated
};

struct CentroidFigure {
  int projector = 0;
  std::string geometry;
  CentroidError error;
};

// What became of one projector's sweep along one axis.
struct SweepFigure {
  int projector = 0;
  std::string axis;  // columns | rows
  std::map<std::string, int64_t> profiles_by_reason;
  int missing_frames = 0;
  // Cycle sum over w / q whites, where both are known: median, and the 95th percentile of its distance from 1.
  int64_t energy_profiles = 0;
  double energy_median = 1.0;
  double energy_p95_error = 0.0;
};

struct StageFigure {
  std::string name;
  double seconds = 0.0;
  double cpu_seconds = 0.0;  // of all threads
  int64_t peak_rss_bytes = 0;
};

struct Metrics {
  std::string session, fit, program_version, options_json;
  std::vector<HeldOutFigure> heldout;
  std::vector<AblationFigure> ablations;
  std::vector<CentroidFigure> centroids;  // of the fitted model's held-out SRDs
  double divergence = 0.0;                // median
  int iterations_median = 0;
  double tau = 0.0;
  SurfaceReflection reflection;
  double wide_weight_fraction = 0.0;  // weight in layers wider than one line, of the total of layers and surface
  int64_t pixels = 0;
  double prior_photons = 0.0;  // N0 of the prior (docs/math/em.md); 0: none
  int64_t weak_pixels = 0;     // fitted, of fewer photons than that: their layers lean on the session's mean
  std::map<std::string, int64_t> masked_by_reason;
  std::vector<SweepFigure> sweeps;
  std::vector<StageFigure> stages;
  DriftReport drift;                  // of the rig since its calibration
  std::optional<SurfaceError> truth;  // only in simulation

  [[nodiscard]] std::string ToJson() const;
};

}  // namespace stratalux::fit
