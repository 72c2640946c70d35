// SPDX-License-Identifier: Apache-2.0
// Exposure for every skin: chosen from one white and one black frame of each projector (the pre-scan).
#pragma once

#include <chrono>
#include <vector>

#include "firmware-host/sequence/visit_time.h"
#include "firmware-host/session/lit_blocks.h"
#include "shared/base/result.h"
#include "shared/capture/finding.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

struct ExposureRule {
  // Of white minus black of a quad (the mosaic's 2x2 samples together), of the darkest tenth of the lit quads.
  // A sample has about half a quad's ratio: at 16 the decoder's coarse bits, which keep half of white's contrast,
  // differ by the four standard deviations that it calls certain (docs/capture-plan.md, "Exposure").
  double wanted_snr = 16.0;
  double max_saturated = 0.005;  // of the lit samples
  // More light is better: the exposure is no shorter than this, unless it saturates.
  double nominal_ms = 16.0;
  double shortest_ms = 0.5, longest_ms = 100.0;
  // Of the camera.
  double black_level_dn = 0.0, saturation_dn = 4095.0, gain_e_per_dn = 4.0, read_noise_dn = 3.0;
};

struct ExposureChoice {
  double exposure_ms = 0.0;
  double snr = 0.0;                // foreseen, of the darkest tenth, of the projector that has it lowest
  double saturated = 0.0;          // foreseen share, of the projector that has it highest
  bool prescan_saturated = false;  // a brighter projector than the pre-scan could measure: take it again, shorter
  std::vector<Finding> findings;   // kDim, kSaturated: what no exposure within the rule's bounds reaches
};

// One exposure for all projectors: the nominal one, or a longer one at which each has the wanted ratio, unless one
// would saturate or the bounds end before. Of what is lit (LitBlocks). kFailed where no projector lights anything.
[[nodiscard]] Result<ExposureChoice> ChooseExposure(const std::vector<PreScan>& scans, double scan_ms,
                                                    const ExposureRule& rule);

// The longest exposure, ms, at which the plan takes no longer than this; to a hundredth, 0 where none does. Fails as
// BuildPlan.
[[nodiscard]] Result<double> LongestExposureMs(const PlanOptions& plan, const VisitTiming& timing,
                                               std::chrono::nanoseconds visit);

}  // namespace stratalux::rig
