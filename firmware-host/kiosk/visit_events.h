// SPDX-License-Identifier: Apache-2.0
// What the kiosk's machine is told (visit_machine.h). Whole numbers alone, so that equal events are equal to the bit.
#pragma once

#include <cstdint>
#include <string>
#include <variant>

#include "firmware-host/kiosk/words.h"

namespace stratalux::rig {

// What a visitor agrees to. Language and text are places in the shell's lists.
struct ConsentChoice {
  bool fit = false, research = false, publication = false;
  uint8_t language = 0;
  uint8_t text = 0;

  friend bool operator==(const ConsentChoice&, const ConsentChoice&) = default;
};

// The lit foreground, thousandths of the frame's width and height from its left upper corner.
struct FaceBox {
  int left = 0, top = 0, right = 0, bottom = 0;

  friend bool operator==(const FaceBox&, const FaceBox&) = default;
};

// What the gate goes by (findings_gate.h), of one capture.
struct CaptureFacts {
  // kFailed: not worth keeping. kDegraded: a finding says why it is worth less.
  enum class Worth : uint8_t { kComplete, kDegraded, kFailed };
  Worth worth = Worth::kComplete;
  bool light_taken = false;  // it ended because the guard took the light away, nobody having asked for it
  bool unproven = false;     // steps without proof, or proofs that contradict one another
  bool lamp = false;         // the lamps' light is not what it was
  bool mixed_up = false;     // comb cycles, or a frame alone, do not add up
  bool moved = false;
  int saturated_permille = 0;    // of the lit subject's samples
  int coverage_permille = 1000;  // of what the pre-scan lit, that the capture lit

  friend bool operator==(const CaptureFacts&, const CaptureFacts&) = default;
};

namespace event {

#define SLX_PLAIN_EVENT(Name)                                   \
  struct Name {                                                 \
    friend bool operator==(const Name&, const Name&) = default; \
  }
// The visitor, by button or touch.
SLX_PLAIN_EVENT(Start);
SLX_PLAIN_EVENT(NotSensitive);
SLX_PLAIN_EVENT(Sensitive);
SLX_PLAIN_EVENT(Refuse);  // also: agrees no more
SLX_PLAIN_EVENT(Leave);
// The shell's answers.
SLX_PLAIN_EVENT(NoFace);
SLX_PLAIN_EVENT(Discarded);
SLX_PLAIN_EVENT(DiscardFailed);
SLX_PLAIN_EVENT(Leftover);  // of a visit that was forgotten something may be left
// The page and the machine around it.
SLX_PLAIN_EVENT(PageLost);
SLX_PLAIN_EVENT(PageBack);
SLX_PLAIN_EVENT(ClockJumped);
SLX_PLAIN_EVENT(Shutdown);
#undef SLX_PLAIN_EVENT

struct Agree {
  ConsentChoice choice;
  friend bool operator==(const Agree&, const Agree&) = default;
};
// Of one pre-scan.
struct Face {
  FaceBox box;
  int distance_mm = 0;     // 0: not known, no calibration tells
  int level_permille = 0;  // signal-to-noise ratio of the darkest tenth, of the ratio that is wanted
  int exposure_us = 0;     // that the pre-scan chose
  friend bool operator==(const Face&, const Face&) = default;
};
struct Tick {
  Deadline deadline = Deadline::kNone;
  friend bool operator==(const Tick&, const Tick&) = default;
};
struct Progress {
  int done = 0, of = 0;
  friend bool operator==(const Progress&, const Progress&) = default;
};
struct Captured {
  CaptureFacts facts;
  friend bool operator==(const Captured&, const Captured&) = default;
};
// A pre-scan or a capture that could not be.
struct Failed {
  bool light_taken = false;  // or may shine still: also behind the answer of any other job that ends so
  friend bool operator==(const Failed&, const Failed&) = default;
};
struct Checked {
  bool passed = false;
  bool drifted = false;      // a figure is not where it usually is (selfcheck_trend.h)
  bool light_taken = false;  // as of Failed
  friend bool operator==(const Checked&, const Checked&) = default;
};
// The stop is over and lost devices are open again, or not.
struct Recovered {
  bool good = false;
  friend bool operator==(const Recovered&, const Recovered&) = default;
};
struct InterlockChanged {
  Interlock which = Interlock::kEmergencyStop;
  bool active = false;
  friend bool operator==(const InterlockChanged&, const InterlockChanged&) = default;
};
struct DeviceChanged {
  Device which = Device::kCamera;
  bool there = false;
  friend bool operator==(const DeviceChanged&, const DeviceChanged&) = default;
};
struct Space {
  int64_t bytes = 0;
  friend bool operator==(const Space&, const Space&) = default;
};
struct Calibration {
  bool there = false;
  int age_days = 0;
  friend bool operator==(const Calibration&, const Calibration&) = default;
};
struct Hours {
  bool open = false;
  friend bool operator==(const Hours&, const Hours&) = default;
};
// Of an operator whom the front has recognised.
struct Operator {
  OperatorCommand command = OperatorCommand::kOpen;
  friend bool operator==(const Operator&, const Operator&) = default;
};

}  // namespace event

using VisitEvent =
    std::variant<event::Start, event::NotSensitive, event::Sensitive, event::Agree, event::Refuse, event::Leave,
                 event::Face, event::NoFace, event::Tick, event::Progress, event::Captured, event::Failed,
                 event::Discarded, event::DiscardFailed, event::Checked, event::Recovered, event::InterlockChanged,
                 event::DeviceChanged, event::Space, event::Calibration, event::Hours, event::Operator, event::PageLost,
                 event::PageBack, event::ClockJumped, event::Leftover, event::Shutdown>;

// "face 500 mm", "tick consent", "captured degraded moved".
[[nodiscard]] std::string ToString(const VisitEvent& event);

}  // namespace stratalux::rig
