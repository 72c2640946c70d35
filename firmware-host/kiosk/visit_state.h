// SPDX-License-Identifier: Apache-2.0
// All that the kiosk's machine knows. A value: equal states go on alike.
#pragma once

#include <cstdint>
#include <string>

#include "firmware-host/kiosk/visit_events.h"
#include "firmware-host/kiosk/words.h"

namespace stratalux::rig {

struct VisitState {
  // What may make light. kPreview and kCheck end with LightOff or the check, kCapture with the capture.
  enum class Light : uint8_t { kOff, kPreview, kCapture, kCheck };
  // What the shell owes an answer to, one at a time (pre-scans come by themselves). kReset: the recovery that an
  // operator's reset asked for.
  enum class Work : uint8_t { kNone, kCapture, kDiscard, kRecover, kReset, kCheck };
  // Of the visit's sessions. kBegun: to be kept or discarded; kKept: the ticket was given.
  enum class Sessions : uint8_t { kNone, kBegun, kKept };

  Phase phase = Phase::kClosed;
  // Nobody has said yet that these are good.
  EnumSet<Closure> closed_for = {Closure::kHours, Closure::kSpace, Closure::kCalibration};
  EnumSet<Interlock> interlock;  // active
  EnumSet<Device> lost;
  Word safe_for = Word::kNone;
  Deadline armed = Deadline::kNone;
  Light light = Light::kOff;
  Work work = Work::kNone;
  int faults = 0;  // visits in a row that the rig spoilt

  // Of the visit; as after construction while there is none, but for its number.
  uint32_t visit = 0;
  Sessions sessions = Sessions::kNone;
  bool consented = false;
  ConsentChoice consent;
  int steady = 0;       // pre-scans in a row that found all as it should be
  int count = 0;        // seconds left
  int attempt = 0;      // captures begun
  int unproven = 0;     // of them, without proof
  bool usable = false;  // one of them is worth keeping
  int exposure_us = 0;
  Word word = Word::kNone;  // of the gate, the position; why it ends

  friend bool operator==(const VisitState&, const VisitState&) = default;
};

// "gate moved; visit 3, attempt 1, begun; armed gate; closed for -".
[[nodiscard]] std::string ToString(const VisitState& state);

}  // namespace stratalux::rig
