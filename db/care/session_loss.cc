// SPDX-License-Identifier: Apache-2.0
#include "db/care/session_loss.h"

#include <algorithm>

namespace stratalux::db {
namespace {

// Ranges, not numbers: a forged header may speak of frame 2^62.
std::vector<NumberRange> Gaps(const std::vector<std::pair<int64_t, SegmentFrame>>& frames, int64_t expected) {
  std::vector<NumberRange> gaps;
  int64_t next = 0;
  for (const auto& [segment, frame] : frames) {
    if (frame.header.frame > next) gaps.push_back({next, frame.header.frame - 1});
    next = frame.header.frame + 1;
  }
  if (expected > next) gaps.push_back({next, expected - 1});
  return gaps;
}

std::string StepsText(const std::vector<NumberRange>& gaps, const LossWitnesses& witnesses) {
  std::map<int64_t, int> steps = witnesses.steps;
  for (const KnownFrame& k : witnesses.known) steps.emplace(k.place.frame, k.step);
  std::set<int64_t> lost;
  for (const auto& [frame, step] : steps)
    if (std::any_of(gaps.begin(), gaps.end(),
                    [f = frame](const NumberRange& r) { return r.first <= f && f <= r.last; }))
      lost.insert(step);
  std::vector<NumberRange> ranges;
  for (const int64_t step : lost) AppendNumber(ranges, step);
  return ranges.empty() ? "" : " (steps " + ToText(ranges) + ")";
}

void CheckFrames(const RebuiltSession& session, const LossWitnesses& witnesses, std::vector<std::string>& loss) {
  const auto there = static_cast<int64_t>(session.frames.size());
  const auto& manifest = witnesses.manifest;
  int64_t expected = manifest ? manifest->frames : 0;
  const std::vector<NumberRange> inner = Gaps(session.frames, expected);
  // What the old index says beyond that counts unless the manifest is satisfied.
  if (!manifest || !inner.empty())
    for (const KnownFrame& k : witnesses.known) expected = std::max(expected, k.place.frame + 1);
  const std::vector<NumberRange> gaps = Gaps(session.frames, expected);
  const int64_t missing = CountOf(gaps);
  if (missing > 0)
    loss.push_back(std::to_string(missing) + " of " + std::to_string(missing + there) +
                   " frames are missing: " + ToText(gaps) + StepsText(gaps, witnesses));
  // A session that failed may hold more than was acknowledged when it ended.
  if (manifest && there > manifest->frames && session.info.status != SessionStatus::kFailed)
    loss.push_back("the manifest speaks of " + std::to_string(manifest->frames) + " frames, the segments hold " +
                   std::to_string(there));
}

// A complete session has proven every step of its plan; the others say that they lack some.
void CheckPlan(const RebuiltSession& session, std::vector<std::string>& loss) {
  if (session.info.status != SessionStatus::kComplete || session.info.plan_json.empty()) return;
  const auto options = PlanOptionsFromJson(session.info.plan_json);
  const auto plan = options.ok() ? BuildPlan(*options) : Result<CapturePlan>(options.status());
  if (!plan.ok()) return;  // the gate speaks of it
  std::set<int> good;
  for (const auto& [segment, frame] : session.frames)
    if (frame.header.level_check != static_cast<uint16_t>(LevelCheck::kFailed)) good.insert(frame.header.step);
  const std::vector<NumberRange> lacking = LackingSteps(*plan, good);
  // No count: this line stays among the session's reasons, which a later rebuild is held against.
  if (!lacking.empty()) loss.push_back("planned steps without a good frame: " + ToText(lacking));
}

}  // namespace

std::vector<NumberRange> LackingSteps(const CapturePlan& plan, const std::set<int>& good) {
  std::vector<NumberRange> lacking;
  for (const PlanStep& step : plan.steps)
    if (!good.contains(step.index)) AppendNumber(lacking, step.index);
  return lacking;
}

std::vector<std::string> FindLoss(const RebuiltSession& session, const std::vector<std::string>& segments_there,
                                  const LossWitnesses& witnesses) {
  std::vector<std::string> loss;
  if (witnesses.manifest)
    for (const std::string& name : witnesses.manifest->segments)
      if (std::find(segments_there.begin(), segments_there.end(), name) == segments_there.end())
        loss.push_back("segment " + name + " is missing");
  CheckFrames(session, witnesses, loss);
  CheckPlan(session, loss);
  return loss;
}

}  // namespace stratalux::db
