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

bool OfSweep(const PlanStep& step) { return step.phase == CapturePhase::kSweep || step.phase == CapturePhase::kMotion; }

// Whether `step` is shown while the frame of `before` is read out.
bool Follows(const PlanStep& step, const PlanStep& before, bool sweep_begun) {
  return step.projector >= 0 && step.projector == before.projector && step.exposure_ms == before.exposure_ms &&
         (sweep_begun || !OfSweep(step));
}

// The clock of a triggered capture.
class TriggeredClock {
 public:
  explicit TriggeredClock(const VisitTiming& timing) : t_(timing) {}

  void Shoot(const PlanStep& step) {
    PassTo(end_);
    const nanoseconds sync = now_ + t_.sync_delay;
    PassTo(sync);
    if (t_.camera.read_out == ReadOut::kSerial) Collect();
    PassTo(std::max(sync + t_.settle, next_trigger_));
    const nanoseconds exposed = now_ + ExposureOf(step);
    next_trigger_ = now_ + t_.camera.min_frame_period;
    Collect();
    end_ = exposed + t_.camera.exposure_margin;
    frame_ = exposed + t_.transfer;
  }

  // The frame under way comes before anything else happens.
  void Finish() {
    PassTo(end_);
    Collect();
  }

  [[nodiscard]] nanoseconds now() const { return now_; }

 private:
  void PassTo(nanoseconds time) { now_ = std::max(now_, time); }
  void Collect() {
    PassTo(frame_);
    end_ = now_;
  }

  const VisitTiming& t_;
  nanoseconds now_ = nanoseconds(0);
  nanoseconds next_trigger_ = nanoseconds(0);  // not before
  // Of the last exposure: when the projector may step on, when the frame is here.
  nanoseconds end_ = nanoseconds(0), frame_ = nanoseconds(0);
};

nanoseconds OfTriggered(const CapturePlan& plan, const VisitTiming& timing) {
  TriggeredClock clock(timing);
  const PlanStep* before = nullptr;
  bool sweep_begun = false;
  for (const PlanStep& step : plan.steps) {
    if (before != nullptr && before->projector != step.projector) sweep_begun = false;
    if (before != nullptr && !Follows(step, *before, sweep_begun)) clock.Finish();
    clock.Shoot(step);
    sweep_begun = sweep_begun || OfSweep(step);
    before = &step;
  }
  clock.Finish();
  return clock.now();
}

}  // namespace

nanoseconds VisitTime(const CapturePlan& plan, const VisitTiming& timing) {
  if (plan.options.sync_mode == SyncMode::kTriggered) return timing.loading + OfTriggered(plan, timing);
  nanoseconds sum = timing.loading;
  for (const PlanStep& step : plan.steps) sum += OfStreamStep(step, timing);
  return sum;
}

nanoseconds LoadingTime(const CapturePlan& plan, const MemoryLayout& layout,
                        std::span<const std::optional<MemoryTiming>> timing) {
  nanoseconds sum(0);
  for (size_t p = 0; p < std::min(timing.size(), layout.projectors.size()); ++p) {
    if (!timing[p]) continue;
    const std::vector<Pattern> sequence = SequenceOf(plan, static_cast<int>(p));
    const auto way = FindWay(layout.projectors[p].patterns, sequence, 0, *timing[p]);
    if (way && !sequence.empty()) sum += TimeOf(*way, *timing[p]);
  }
  return sum;
}

}  // namespace stratalux::rig
