// SPDX-License-Identifier: Apache-2.0
// The kiosk's states and what leads from one to the next (docs/kiosk.md). Pure: no clock, no device, no file, no text.
// Time enters as Tick, the world as events; all that is done is an action, which the shell (kiosk.h) performs and
// answers with an event. The same events give the same actions, bit for bit.
//
// What holds in every run:
//   1 Light may be on in kPosition, kCapture and kSelfcheck alone; what takes the visitor out of them begins with
//     LightOff.
//   2 Nothing is captured before the visitor agreed, nothing is stored before a capture.
//   3 Every session that was begun is kept with a ticket or discarded; of a visit at most `attempts` captures.
//   4 From any state ticks alone lead to kIdle, kClosed or kSafe.
//   5 E-STOP and door lead to kSafe from everywhere; only an operator's reset with a closed interlock leads out.
//   6 A page that is gone changes nothing but what is shown.
//   7 The same events give the same actions, bit for bit.
//   8 kGate offers to keep exactly where a capture of the visit is worth keeping.
#pragma once

#include <vector>

#include "firmware-host/kiosk/visit_actions.h"
#include "firmware-host/kiosk/visit_events.h"
#include "firmware-host/kiosk/visit_rules.h"
#include "firmware-host/kiosk/visit_state.h"

namespace stratalux::rig {

struct VisitStep {
  VisitState state;
  std::vector<VisitAction> actions;

  friend bool operator==(const VisitStep&, const VisitStep&) = default;
};

// Reentrant. `rules` are the same for a machine's whole life.
[[nodiscard]] VisitStep Step(const VisitRules& rules, const VisitState& state, const VisitEvent& event);

}  // namespace stratalux::rig
