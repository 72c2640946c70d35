// SPDX-License-Identifier: Apache-2.0
// Line-spread profiles of the simulated skin straight from Monte Carlo (no table), as CSV for `stratalux-fit profiles`.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "firmware-host/simulated/skin/skin_optics.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct LineSpreadOptions {
  SkinParameters skin;
  int channel = 0;  // 0 R, 1 G, 2 B
  std::vector<double> incidence_deg = {-45, 0, 30};
  std::vector<double> exit_deg = {0};
  std::vector<double> slit_mm = {0.5};
  double step_mm = 0.25;
  double half_width_mm = 12.0;
  double acceptance_deg = 6.0;  // half-angle of the accepted exit cone
  int64_t photons = 1000000;    // for each incidence
  uint64_t seed = 1;            // lights of either sign have photons of their own
  [[nodiscard]] Status Validate() const;
};

// Columns source,incidence_deg,exit_deg,slit_mm,u_mm,radiance; source = "i<incidence> e<exit> s<slit>".
// u = observed minus line position; incidence > 0: light travels towards +u; exit > 0: light leaves towards +u;
// radiance in the reflectance unit (pi times radiance over irradiance), averaged over the step. The options are valid.
[[nodiscard]] std::string LineSpreadCsv(const LineSpreadOptions& options);

}  // namespace stratalux::rig
