// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/findings_gate.h"

#include <cstdlib>
#include <string>

namespace stratalux::rig {

Status VisitRules::Validate() const {
  const auto range = [](const char* key, int64_t value, int64_t low, int64_t high) {
    return value >= low && value <= high
               ? Status::Ok()
               : Status::Usage("kiosk." + std::string(key) + ": value " + std::to_string(value) +
                               ", allowed: " + std::to_string(low) + " .. " + std::to_string(high));
  };
  SLX_RETURN_IF_ERROR(range("attempts", attempts, 1, 3));
  SLX_RETURN_IF_ERROR(range("countdown_s", countdown, 1, 30));
  SLX_RETURN_IF_ERROR(range("steady_looks", steady_looks, 1, 20));
  if (furthest_mm > 0 && furthest_mm <= nearest_mm)
    return Status::Usage("kiosk.furthest_mm = " + std::to_string(furthest_mm) +
                         " is not beyond nearest_mm = " + std::to_string(nearest_mm) + ": nobody can sit there");
  if (paper_consent && !paper.fit) return Status::Usage("kiosk.paper_consent: a capture needs the scope fit");
  return Status::Ok();
}

Word JudgeFace(const event::Face& face, const VisitRules& rules) {
  const FaceBox& box = face.box;
  if (face.distance_mm > 0 && rules.furthest_mm > 0 && face.distance_mm > rules.furthest_mm) return Word::kCloser;
  if (face.distance_mm > 0 && rules.nearest_mm > 0 && face.distance_mm < rules.nearest_mm) return Word::kBack;
  if (box.bottom - box.top < rules.height_permille) return Word::kCloser;
  const bool cut = box.left < rules.margin_permille || box.top < rules.margin_permille ||
                   box.right > 1000 - rules.margin_permille || box.bottom > 1000 - rules.margin_permille;
  const bool beside = std::abs((box.left + box.right) / 2 - 500) > rules.off_centre_permille ||
                      std::abs((box.top + box.bottom) / 2 - 500) > rules.off_centre_permille;
  if (cut || beside) return Word::kCentre;
  return face.level_permille < rules.level_permille ? Word::kBrighter : Word::kHold;
}

Judgement JudgeCapture(const CaptureFacts& facts, const VisitSoFar& before, const VisitRules& rules) {
  const bool failed = facts.worth == CaptureFacts::Worth::kFailed;
  const bool unproven = facts.unproven || failed;
  if (facts.light_taken) return {Verdict::kSafe, Word::kLight};
  if (unproven && before.unproven > 0) return {Verdict::kSafe, Word::kProof};
  const bool last = before.attempt >= rules.attempts;
  const Verdict offer = last ? Verdict::kAccept : Verdict::kOffer;
  if (unproven) return {offer, Word::kProof};
  if (facts.lamp) return {Verdict::kAccept, Word::kLamp};
  if (facts.saturated_permille > rules.most_saturated_permille) {
    const bool shorter = !last && before.exposure_us / 2 >= rules.shortest_exposure_us;
    return {shorter ? Verdict::kRetakeShorter : Verdict::kAccept, Word::kSaturated};
  }
  if (facts.mixed_up) return {offer, Word::kMixedUp};
  if (facts.moved) return {offer, Word::kMoved};
  if (facts.coverage_permille < rules.least_coverage_permille) return {offer, Word::kCoverage};
  return {};
}

}  // namespace stratalux::rig
