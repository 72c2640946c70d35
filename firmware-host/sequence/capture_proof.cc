// SPDX-License-Identifier: Apache-2.0
// The end of a capture: what of it is proven.
#include <algorithm>
#include <set>

#include "firmware-host/sequence/capture_run.h"

namespace stratalux::rig {

Status CaptureRun::CheckProof() {
  std::set<int64_t> triggers, sequences;
  for (const auto& [step, record] : proven_) {
    const bool fresh = triggers.insert(record.trigger_number).second && sequences.insert(record.driver_sequence).second;
    if (!fresh) SLX_RETURN_IF_ERROR(Add({FindingKind::kProofReused, record.projector, step}));
  }
  for (Finding& finding : witness_.CheckSession()) SLX_RETURN_IF_ERROR(Add(std::move(finding)));
  for (int step : report_.missing_steps)
    if (!wrong_level_.contains(step))
      SLX_RETURN_IF_ERROR(Add({FindingKind::kNoProof, plan_.steps[step].projector, step}));
  for (int step : wrong_level_)
    SLX_RETURN_IF_ERROR(Add({FindingKind::kWrongPattern, plan_.steps[step].projector, step}));
  const int64_t spoken_for = report_.frames + spoilt_triggers_;
  if (shooter_.camera_triggers() != spoken_for)
    SLX_RETURN_IF_ERROR(Add({FindingKind::kTriggersUnmatched, -1, -1, static_cast<double>(shooter_.camera_triggers()),
                             static_cast<double>(spoken_for)}));
  return Status::Ok();
}

CaptureReport CaptureRun::Conclude(Status ended) {
  report_.transition_frames = static_cast<int>(shooter_.transition_frames());
  report_.transition_lost = static_cast<int>(shooter_.transition_lost());
  report_.slow = shooter_.answers().Slow();
  for (const SlowAnswers& slow : report_.slow) logger_.Warning(SlowAnswersAsText(slow));
  // Shot before the code was given up.
  std::erase_if(proven_, [this](const auto& proof) { return LacksCode(plan_.steps[proof.first]); });
  report_.captured = static_cast<int>(proven_.size());
  for (const PlanStep& step : plan_.steps)
    if (!proven_.contains(step.index)) report_.missing_steps.push_back(step.index);
  if (ended.ok()) ended = CheckProof();
  if (ended.ok()) {
    report_.status = report_.findings.empty() ? SessionStatus::kComplete : SessionStatus::kDegraded;
    return report_;
  }
  // What took the light ended the capture, whatever device noticed it.
  Finding why = {devices_.light.stop().stopped() ? FindingKind::kStopped : FindingKind::kDevice,
                 -1,
                 -1,
                 0.0,
                 0.0,
                 ended.message()};
  if (ended_for_) why = *ended_for_;
  report_.findings.insert(report_.findings.begin(), std::move(why));
  report_.status = SessionStatus::kFailed;
  return report_;
}

}  // namespace stratalux::rig
