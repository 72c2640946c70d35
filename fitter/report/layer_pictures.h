// SPDX-License-Identifier: Apache-2.0
// The report's section on the layers: what lies at which depth.
#pragma once

#include <optional>

#include "fitter/report/html_report.h"
#include "fitter/stages/layer_maps.h"
#include "fitter/stages/maps.h"

namespace stratalux::fit {

// What of a map of layers is shown.
struct ShownLayers {
  LayerMaps maps;
  Image<float> signal_to_noise;            // W x H x C, of SignalToNoise()
  double session_photons = 0.0;            // N0 of the session's mean; 0: no prior
  bool neighbours = false;                 // the prior is centred on neighbours' layers
  std::string provenance;                  // ProvenanceOf
  std::optional<MapsFigures> of_all = {};  // of maps from all projectors
};
// `projectors`: of the rig.
[[nodiscard]] ShownLayers ShownOf(const FittedLayers& layers, int projectors);

[[nodiscard]] ReportSection LayerPictures(const ShownLayers& shown);

}  // namespace stratalux::fit
