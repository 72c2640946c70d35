// SPDX-License-Identifier: Apache-2.0
// What the kiosk's machine asks its shell to do (visit_machine.h), in this order.
#pragma once

#include <cstdint>
#include <string>
#include <variant>

#include "firmware-host/kiosk/visit_events.h"
#include "firmware-host/kiosk/words.h"

namespace stratalux::rig {
namespace action {

#define SLX_PLAIN_ACTION(Name)                                  \
  struct Name {                                                 \
    friend bool operator==(const Name&, const Name&) = default; \
  }
// At once, and nothing that runs may make light again: a pre-scan or a capture that is under way ends.
SLX_PLAIN_ACTION(LightOff);
// Pre-scans, one after the other, until LightOff; each is answered by Face, NoFace or Failed. Nothing is stored.
SLX_PLAIN_ACTION(Preview);
// Answered by Checked.
SLX_PLAIN_ACTION(CheckRig);
// The stop is taken back where its reason is gone, lost devices are opened. Answered by Recovered.
SLX_PLAIN_ACTION(Recover);
#undef SLX_PLAIN_ACTION

// Answered by Progress, and once by Captured or Failed. The consent is entered with it; the shell names visitor and
// visit by the number.
struct StartCapture {
  uint32_t visit = 0;
  int attempt = 0;
  int exposure_us = 0;
  ConsentChoice consent;
  friend bool operator==(const StartCapture&, const StartCapture&) = default;
};
// Answered as the capture is.
struct StopCapture {
  Word reason = Word::kNone;
  friend bool operator==(const StopCapture&, const StopCapture&) = default;
};
// Every session of the visit is forgotten, its consent as well. Answered by Discarded or DiscardFailed.
struct Discard {
  uint32_t visit = 0;
  Word reason = Word::kNone;
  friend bool operator==(const Discard&, const Discard&) = default;
};
struct Show {
  Phase screen = Phase::kIdle;
  Word word = Word::kNone;
  EnumSet<Closure> closures;  // of kClosed
  int number = 0, of = 0;     // seconds of a countdown, steps of a capture, attempts at the gate
  FaceBox box;                // of kPosition
  bool usable = false;        // of kGate: a capture is worth keeping, and is kept where the visitor ends here
  friend bool operator==(const Show&, const Show&) = default;
};
struct PrintTicket {
  uint32_t visit = 0;
  friend bool operator==(const PrintTicket&, const PrintTicket&) = default;
};
struct TellOperator {
  Word word = Word::kNone;
  friend bool operator==(const TellOperator&, const TellOperator&) = default;
};
// One more visit that ended so and left nothing else.
struct Count {
  Word end = Word::kNone;
  friend bool operator==(const Count&, const Count&) = default;
};
// In place of the deadline that runs; kNone: none does.
struct Arm {
  Deadline deadline = Deadline::kNone;
  friend bool operator==(const Arm&, const Arm&) = default;
};

}  // namespace action

using VisitAction = std::variant<action::LightOff, action::Preview, action::CheckRig, action::Recover,
                                 action::StartCapture, action::StopCapture, action::Discard, action::Show,
                                 action::PrintTicket, action::TellOperator, action::Count, action::Arm>;

// "light_off", "start_capture 2 16000us", "show gate moved", "arm gate".
[[nodiscard]] std::string ToString(const VisitAction& action);

}  // namespace stratalux::rig
