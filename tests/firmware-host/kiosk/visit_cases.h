// SPDX-License-Identifier: Apache-2.0
// The states and events of the written specification (visit_table.txt), by name, and random sequences of events.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "firmware-host/kiosk/visit_machine.h"
#include "shared/base/random.h"

namespace stratalux::rig {

using StepFunction = std::function<VisitStep(const VisitRules&, const VisitState&, const VisitEvent&)>;

[[nodiscard]] VisitRules TableRules();
[[nodiscard]] std::map<std::string, VisitState> TableStates();
// `tick` stands for that of the state's own deadline.
[[nodiscard]] std::map<std::string, VisitEvent> TableEvents(const VisitState& state);

// Any event, also those that make no sense; those that lead on through a visit come more often.
[[nodiscard]] VisitEvent AnyEvent(Random& random, const VisitState& state);

}  // namespace stratalux::rig
