// SPDX-License-Identifier: Apache-2.0
// What a capture came to: how many steps are proven, what went wrong on the way, and whether the session is complete.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "firmware-host/sequence/deadlines.h"
#include "shared/capture/finding.h"
#include "shared/capture/session.h"

namespace stratalux::rig {

// Why a shot does not count. Each is named in the report.
enum class ShotFault {
  kNone,
  kMissingSync,    // no SYNC edge by the deadline: the projector may not have stepped
  kExtraSync,      // a SYNC edge nobody asked for: the projector may have stepped twice
  kLostFrame,      // no frame by the deadline
  kSequenceGap,    // the driver's number jumped: a frame was dropped
  kDoubledFrame,   // two frames for one trigger
  kOutOfOrder,     // a frame of an earlier trigger
  kLateFrame,      // exposed outside the trigger's time window
  kCorruptFrame,   // the driver's error flag
  kWrongLevel,     // the frame does not show the planned pattern (pattern_witness.h)
  kRepeatedRows,   // rows of an earlier frame, bit by bit: a frozen buffer or a torn transfer (row_memory.h)
  kWrongExposure,  // the camera reports another exposure or gain than was set
  kSubjectMoved,   // the subject jumped: once a jump, for all shots of its projector
};
inline constexpr int kShotFaultCount = 13;

[[nodiscard]] const char* ToString(ShotFault fault);

struct CaptureReport {
  int planned = 0;            // steps of the plan
  int captured = 0;           // steps with a proven frame
  int retried = 0;            // shots taken again
  int frames = 0;             // frames handed to the sink, retries included
  int transition_frames = 0;  // free_running: frames between two steps, looked at by number and time, not kept
  int transition_lost = 0;    // free_running: numbers missing among them
  std::array<int, kShotFaultCount> faults{};
  std::vector<int> missing_steps;  // steps left without a proven frame
  SessionStatus status = SessionStatus::kRecording;
  std::vector<Finding> findings;  // why not complete, in the order they came up
  // Answers that came later than a selftest learnt: no reason against the session, but for another selftest.
  std::vector<SlowAnswers> slow;

  [[nodiscard]] int Count(ShotFault fault) const { return faults[static_cast<size_t>(fault)]; }
  void Note(ShotFault fault) { ++faults[static_cast<size_t>(fault)]; }
  // The findings, and the faults that happened by their names. A figure that is not finite becomes 0: the store takes
  // none, and would not seal the session.
  [[nodiscard]] CaptureFindings Found() const;
  // The same findings for people.
  [[nodiscard]] std::vector<std::string> Reasons() const { return ToText(Found().findings); }
  // "lost frame 2, corrupt frame 1", empty when nothing went wrong.
  [[nodiscard]] std::string FaultSummary() const;
};

}  // namespace stratalux::rig
