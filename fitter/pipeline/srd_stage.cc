// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/srd_stage.h"

#include "fitter/srd/srd_extractor.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {

Result<SrdSet> ExtractSrds(const SessionFrames& frames, const SurfaceMap& surface,
                           const std::vector<Image<uint8_t>>& lit, int pool, Logger& logger) {
  const RigCalibration& rig = *frames.calibration();
  const PlanOptions& plan = *frames.plan();
  const CombCycle cycle{plan.comb_period, plan.comb_width, plan.comb_step, plan.exposure_ms};
  SLX_RETURN_IF_ERROR(cycle.Validate());
  SrdOptions options;
  options.pool = pool;
  SrdSet set;
  set.pool = pool;
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p) {
    SrdExtractor extractor(surface, lit[p], rig, p, cycle, options);
    SLX_ASSIGN_OR_RETURN(const auto dark, frames.MeanBlack(p));
    for (int k = 0; k < cycle.frames(); ++k) {
      SLX_ASSIGN_OR_RETURN(
          const auto raw,
          frames.Read(
              p, CapturePhase::kSweep,
              {.kind = PatternKind::kComb, .period = cycle.period, .width = cycle.width, .shift = k * cycle.step}));
      extractor.AddFrame(k, raw, dark);
    }
    int whites = 0;
    SLX_ASSIGN_OR_RETURN(const auto white, frames.MeanWhite(p, whites));
    extractor.SetWhite(white, whites, dark);
    set.batches.push_back(extractor.Take());
    std::string text = "SRDs of projector " + std::to_string(p) + ":";
    for (int r = 0; r < kSrdReasons; ++r)
      text += std::string(r == 0 ? " " : ", ") + ToString(static_cast<SrdReason>(r)) + " " +
              std::to_string(extractor.counts()[r]);
    logger.Info(text);
    set.width = extractor.width();
    set.height = extractor.height();
    set.channels = QuadChannels(rig.camera.cfa);
  }
  return set;
}

}  // namespace stratalux::fit
