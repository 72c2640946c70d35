// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/visit_time.h"

#include <algorithm>

#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

using std::chrono::nanoseconds;

nanoseconds ExposureOf(const PlanStep& step) { return FromMilliseconds(step.exposure_ms); }

// A stream's frame counts from the first exposure after settling; its frames come in whole periods.
nanoseconds OfStreamStep(const PlanStep& step, const VisitTiming& t) {
  const nanoseconds busy = ExposureOf(step) + t.transfer;
  const nanoseconds period = std::max({t.frame_period, busy, nanoseconds(1)});
  const nanoseconds whole = busy + t.sync_delay + t.settle;
  return period * ((whole + period - nanoseconds(1)) / period);
}

// From the camera's trigger to that of the next step.
nanoseconds ToNext(const PlanStep& step, const VisitTiming& t) {
  const nanoseconds shown = ExposureOf(step) + t.camera.exposure_margin + t.sync_delay + t.settle;
  const bool serial = t.camera.read_out == ReadOut::kSerial;
  return std::max({shown, t.camera.min_frame_period, serial ? ExposureOf(step) + t.transfer : nanoseconds(0)});
}

}  // namespace

nanoseconds VisitTime(const CapturePlan& plan, const VisitTiming& timing) {
  nanoseconds sum(0);
  for (size_t i = 0; i < plan.steps.size(); ++i) {
    const PlanStep& step = plan.steps[i];
    if (plan.options.sync_mode == SyncMode::kFreeRunning) {
      sum += OfStreamStep(step, timing);
      continue;
    }
    const bool goes_on = i + 1 < plan.steps.size() && step.projector >= 0 &&
                         plan.steps[i + 1].projector == step.projector &&
                         plan.steps[i + 1].exposure_ms == step.exposure_ms;
    const bool follows = i > 0 && step.projector >= 0 && plan.steps[i - 1].projector == step.projector &&
                         plan.steps[i - 1].exposure_ms == step.exposure_ms;
    if (!follows) sum += timing.sync_delay + timing.settle;
    sum += goes_on ? ToNext(step, timing) : ExposureOf(step) + timing.transfer;
  }
  return sum;
}

}  // namespace stratalux::rig
