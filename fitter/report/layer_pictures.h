// SPDX-License-Identifier: Apache-2.0
// The report's section on the layers: what lies at which depth.
#pragma once

#include "fitter/mixture/mixture_map.h"
#include "fitter/report/html_report.h"
#include "fitter/stages/layer_maps.h"

namespace stratalux::fit {

// `signal_to_noise`: W x H x C, of SignalToNoise().
[[nodiscard]] ReportSection LayerPictures(const MixtureMap& map, const LayerMaps& maps,
                                          const Image<float>& signal_to_noise);

}  // namespace stratalux::fit
