// SPDX-License-Identifier: Apache-2.0
// Scattering layers of measured line-spread profiles: fit them, keep them as JSON, predict other geometries.
//
//   y(u) = background + g(incidence) g(exit) sum_l w_l f_l mean over the u step of
//          [Phi((u + slit/2 - d_l s) / sigma_l) - Phi((u - slit/2 - d_l s) / sigma_l)],
//   s = T(incidence) + T(exit), T odd (the shift law of model section 6), g the angular gain of model section 7, f_l
//   the layer's directional weight (fitter/mixture/directional_weights.h).
// Incidence and exit enter alike, as reciprocity wants. sum_l w_l is the albedo at normal incidence and view.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/standard_errors.h"
#include "fitter/profiles/profile_csv.h"

namespace stratalux::fit {

// What was fitted to one source. In free mode depth_mm holds the layers' displacements along u, mm, for this source
// alone.
struct SourceFit {
  std::string source;
  double incidence_deg = 0.0, exit_deg = 0.0, slit_mm = 0.0;
  LayerSet layers;  // free mode
  double background = 0.0;
  double divergence = 0.0;
  int iterations = 0;
  double nrmse = 0.0;  // RMS(model - data) / RMS(data)
};

struct ProfileModel {
  ScatteringModel scattering;
  LayerSet layers;                               // tied mode
  std::optional<EffectiveParameters> effective;  // tied mode, after a fit
  double background = 0.0;
  double divergence = 0.0;
  int iterations = 0;
  bool depth_estimable = true;  // false: no source's geometry shifts the layers
  std::vector<SourceFit> sources;
  std::vector<std::string> warnings;  // what a user should know of the data

  [[nodiscard]] std::string ToJson() const;
  // kUsage names `origin` and what is wrong.
  static Result<ProfileModel> FromJson(const std::string& text, const std::string& origin);
};

// Options that suit measured profiles: no surface term (its light is a narrow layer here), one floor, a fine grid.
[[nodiscard]] EmOptions ProfileOptions();

// Whether layers have directional weights. kAuto: only if all sources together ask for them (a likelihood ratio); light
// of layers that know no direction would else lose some of their depth to the weights.
enum class Directional : uint8_t { kAuto, kOn, kOff };

// kUsage names a source without light or without a line. tau and the directional weights are those that suit all
// sources best. Free mode fits layers alone.
[[nodiscard]] Result<ProfileModel> FitProfiles(const std::vector<LineProfile>& profiles, const EmOptions& options,
                                               Directional directional = Directional::kAuto);

// Radiances on the profile's own grid. kUsage in free mode when the model has no layers for the profile's source.
[[nodiscard]] Result<std::vector<double>> PredictProfile(const ProfileModel& model, const LineProfile& profile);

}  // namespace stratalux::fit
