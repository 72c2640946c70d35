// SPDX-License-Identifier: Apache-2.0
#include "fitter/session/sinusoid_sets.h"

#include <algorithm>
#include <set>
#include <utility>

namespace stratalux::fit {
namespace {

void FindShifts(const SessionFrames& frames, int projector, int pose, PatternAxis axis, SinusoidSet& set) {
  for (int shift = 0; shift < set.shifts; ++shift) {
    const db::FrameRow* row = frames.Find(
        projector, CapturePhase::kSeparation,
        {.kind = PatternKind::kSinusoid, .axis = axis, .period = set.period_px, .shift = shift, .shifts = set.shifts},
        pose);
    if (row != nullptr) set.rows.push_back(row);
  }
}

}  // namespace

const char* AxisName(PatternAxis axis) { return axis == PatternAxis::kColumns ? "columns" : "rows"; }

std::vector<SinusoidSet> SinusoidSets(const SessionFrames& frames, int projector, int pose, PatternAxis axis) {
  std::set<std::pair<int, int>> kinds;  // period; shifts, most first
  if (frames.plan()) {
    kinds.emplace(frames.plan()->separation_period, -frames.plan()->separation_shifts);
  } else {
    for (const db::FrameRow& row : frames.rows()) {
      const FrameRecord& r = row.record;
      if (r.projector == projector && r.pose == pose && r.phase == CapturePhase::kSeparation &&
          r.pattern.kind == PatternKind::kSinusoid && r.pattern.axis == axis)
        kinds.emplace(r.pattern.period, -r.pattern.shifts);
    }
  }
  std::vector<SinusoidSet> sets;
  for (const auto& [period, shifts] : kinds)
    FindShifts(frames, projector, pose, axis, sets.emplace_back(SinusoidSet{period, -shifts}));
  std::ranges::stable_partition(sets, &SinusoidSet::IsWhole);
  return sets;
}

}  // namespace stratalux::fit
