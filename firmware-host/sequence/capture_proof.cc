// SPDX-License-Identifier: Apache-2.0
// The end of a capture: what of it is proven.
#include <algorithm>
#include <set>

#include "firmware-host/sequence/capture_run.h"

namespace stratalux::rig {
namespace {

// "steps 3, 17, 18 and 5 more".
std::string ListSteps(const std::vector<int>& steps) {
  constexpr size_t kNamed = 8;
  std::string text = steps.size() == 1 ? "step " : "steps ";
  for (size_t i = 0; i < std::min(steps.size(), kNamed); ++i) text += (i > 0 ? ", " : "") + std::to_string(steps[i]);
  if (steps.size() > kNamed) text += " and " + std::to_string(steps.size() - kNamed) + " more";
  return text;
}

}  // namespace

void CaptureRun::CheckProof() {
  std::set<int64_t> triggers, sequences;
  for (const auto& [step, record] : proven_) {
    const bool fresh = triggers.insert(record.trigger_number).second && sequences.insert(record.driver_sequence).second;
    if (!fresh) report_.reasons.push_back(Describe(step) + ": its trigger or frame number proves another step, too");
  }
  for (const PlanStep& step : plan_.steps)
    if (!proven_.contains(step.index)) report_.missing_steps.push_back(step.index);
  report_.captured = static_cast<int>(proven_.size());
  for (std::string& reason : witness_.CheckSession()) report_.reasons.push_back(std::move(reason));
  std::vector<int> unproven;
  for (int step : report_.missing_steps)
    if (!wrong_level_.contains(step)) unproven.push_back(step);
  if (!unproven.empty())
    report_.reasons.push_back("no proven frame for " + ListSteps(unproven) + " (" + report_.FaultSummary() + ")");
  if (!wrong_level_.empty())
    report_.reasons.push_back("the level check failed for " +
                              ListSteps(std::vector<int>(wrong_level_.begin(), wrong_level_.end())));
  const int64_t spoken_for = report_.frames + spoilt_triggers_;
  if (shooter_.camera_triggers() != spoken_for)
    report_.reasons.push_back(std::to_string(shooter_.camera_triggers()) + " camera triggers, " +
                              std::to_string(report_.frames) + " frames and " + std::to_string(spoilt_triggers_) +
                              " named losses do not match");
}

CaptureReport CaptureRun::Conclude(const Status& ended) {
  report_.transition_frames = static_cast<int>(shooter_.transition_frames());
  report_.transition_lost = static_cast<int>(shooter_.transition_lost());
  if (!ended.ok()) {
    report_.captured = static_cast<int>(proven_.size());
    for (const PlanStep& step : plan_.steps)
      if (!proven_.contains(step.index)) report_.missing_steps.push_back(step.index);
    report_.reasons.insert(report_.reasons.begin(), ended.message());
    report_.status = SessionStatus::kFailed;
    return report_;
  }
  CheckProof();
  report_.status = report_.reasons.empty() ? SessionStatus::kComplete : SessionStatus::kDegraded;
  return report_;
}

}  // namespace stratalux::rig
