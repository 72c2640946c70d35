// SPDX-License-Identifier: Apache-2.0
// The gates of a visit: may this face be captured, is this capture good enough? Pure.
#pragma once

#include "firmware-host/kiosk/visit_events.h"
#include "firmware-host/kiosk/visit_rules.h"

namespace stratalux::rig {

// What the visitor should do before a capture is worth it; kHold: nothing.
[[nodiscard]] Word JudgeFace(const event::Face& face, const VisitRules& rules);

enum class Verdict : uint8_t {
  kAccept,         // good, or nothing that the visitor could do makes it better
  kOffer,          // once more, if the visitor likes
  kRetakeShorter,  // once more without asking, at half the exposure
  kSafe            // the rig is not to be trusted
};

struct Judgement {
  Verdict verdict = Verdict::kAccept;
  Word word = Word::kNone;  // why not simply accepted; of kAccept: what the operator should know
  friend bool operator==(const Judgement&, const Judgement&) = default;
};

// What was before, in the same visit.
struct VisitSoFar {
  int attempt = 1;   // that was judged
  int unproven = 0;  // attempts before it without proof
  int exposure_us = 0;
};

// In this order: the light was taken away, or the second attempt without proof: kSafe. No proof, or nothing to keep:
// offered. Lamps: accepted, told, no retake mends it. Saturated: shorter, while that is possible. Comb cycles, motion,
// coverage: offered. After the last attempt what is offered is accepted.
[[nodiscard]] Judgement JudgeCapture(const CaptureFacts& facts, const VisitSoFar& before, const VisitRules& rules);

}  // namespace stratalux::rig
