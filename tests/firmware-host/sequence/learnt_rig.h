// SPDX-License-Identifier: Apache-2.0
// What a selftest learns of a simulated rig.
#pragma once

#include <utility>

#include "firmware-host/sequence/rig_check.h"
#include "firmware-host/simulated/simulated_rig.h"

namespace stratalux::rig {

// Of a rig like `options`, without faults; the markers are the plan's pre-roll.
inline Result<RigDelays> LearnDelays(SimulatedRigOptions options, const CapturePlan& plan, Logger& logger) {
  options.faults = {};
  SLX_ASSIGN_OR_RETURN(const std::unique_ptr<SimulatedRig> rig, SimulatedRig::Create(options, logger));
  StopToken stop;
  SLX_ASSIGN_OR_RETURN(const std::unique_ptr<LightGuard> light, GuardLight(*rig, stop));
  RigCheckOptions check;
  check.exposure_ms = plan.options.exposure_ms;
  for (const PlanStep& step : plan.steps)
    if (step.phase == CapturePhase::kPreroll) check.markers.push_back(step.pattern);
  check.wait = [&rig](std::chrono::nanoseconds time) { rig->Sleep(time); };
  SLX_ASSIGN_OR_RETURN(const RigCheckReport report,
                       CheckRig({*light, rig->lines(), rig->camera(), rig->projectors()}, check));
  if (report.delays) return *report.delays;
  std::string failed = "the rig's check failed:";
  for (const CheckItem& item : report.items)
    if (item.state == CheckState::kFailed) failed += " " + item.name + " (" + item.found + ")";
  return Status::Failed(failed);
}

}  // namespace stratalux::rig
