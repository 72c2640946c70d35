// SPDX-License-Identifier: Apache-2.0
// The light part of a calibration's page.
#pragma once

#include <vector>

#include "fitter/calibration/light_report.h"
#include "fitter/report/html_report.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

// `record`: of the same rig; its models place fall-off and vignetting in the pictures. Parts that were not measured are
// left out, and named.
[[nodiscard]] std::vector<ReportSection> LightSections(const LightReport& light, const RigCalibration& record);

}  // namespace stratalux::fit
