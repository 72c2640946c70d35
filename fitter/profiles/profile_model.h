// SPDX-License-Identifier: Apache-2.0
// Scattering layers of measured line-spread profiles: fit them, keep them as JSON, predict other geometries.
//
//   y(u) = background + g sum_l w_l mean over the u step of
//          [Phi((u + slit/2 - d_l s) / sigma_l) - Phi((u - slit/2 - d_l s) / sigma_l)],
//   s = T(incidence) + T(exit), T odd (the shift law of model section 6), g the angular gain of model section 7.
// sum_l w_l is the albedo.
#pragma once

#include <string>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/fit_mixture.h"
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
  FitMode mode = FitMode::kTied;
  ShiftLaw shift_law = ShiftLaw::kRefracted;
  double eta = 1.4;
  bool gain_model = true;
  double tau = 0.0;  // of the angular gain
  LayerSet layers;   // tied mode
  double background = 0.0;
  double divergence = 0.0;
  int iterations = 0;
  bool depth_estimable = true;  // false: no source's geometry shifts the layers
  std::vector<SourceFit> sources;

  [[nodiscard]] std::string ToJson() const;
  // kUsage names `origin` and what is wrong.
  static Result<ProfileModel> FromJson(const std::string& text, const std::string& origin);
};

// Options that suit measured profiles: no surface term (its light is a narrow layer here), one floor, a fine grid.
[[nodiscard]] EmOptions ProfileOptions();

// kUsage: profiles without light. tau is the one that divides the training profiles best, when incidences differ and
// the gain model is on.
[[nodiscard]] Result<ProfileModel> FitProfiles(const std::vector<LineProfile>& profiles, const EmOptions& options);

// Radiances on the profile's own grid. kUsage in free mode when the model has no layers for the profile's source.
[[nodiscard]] Result<std::vector<double>> PredictProfile(const ProfileModel& model, const LineProfile& profile);

}  // namespace stratalux::fit
