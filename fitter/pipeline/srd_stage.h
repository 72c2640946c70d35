// SPDX-License-Identifier: Apache-2.0
// The SRD stage: the frames of each projector's sweep, streamed from the store into batches of samples.
#pragma once

#include <vector>

#include "fitter/mixture/srd_samples.h"
#include "fitter/pipeline/session_frames.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/base/log.h"

namespace stratalux::fit {

// SRDs of every projector on profiles of `pool` x `pool` quads.
struct SrdSet {
  int pool = 1;
  int width = 0, height = 0, channels = 0;
  std::vector<SrdBatch> batches;
};
[[nodiscard]] Result<SrdSet> ExtractSrds(const SessionFrames& frames, const SurfaceMap& surface,
                                         const std::vector<Image<uint8_t>>& lit, int pool, Logger& logger);

}  // namespace stratalux::fit
