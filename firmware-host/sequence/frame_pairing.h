// SPDX-License-Identifier: Apache-2.0
// FramePairing: which trigger a frame answers, by number AND by time.
//
// Camera triggers and the driver's frame numbers advance together, so their difference is constant; the frame's own
// time must lie in [trigger, trigger + exposure + slack]. Either alone can be fooled: numbers by a trigger the camera
// ignored, times by a frame that was dropped and a spurious one that took its place.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "firmware-host/camera/frame_source.h"
#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/sequence/capture_report.h"

namespace stratalux::rig {

class FramePairing {
 public:
  explicit FramePairing(std::chrono::nanoseconds slack) : slack_(slack) {}

  // kNone: the frame is this trigger's. kOutOfOrder: it belongs to the past, keep waiting. kDoubledFrame: a number seen
  // before, keep waiting. kSequenceGap, kLateFrame, kCorruptFrame: the shot is spoilt.
  [[nodiscard]] ShotFault Match(const TriggerReceipt& trigger, double exposure_ms, const CapturedFrame& frame);
  // The frame's number is that of the trigger behind the one that is awaited, and so is its time.
  [[nodiscard]] bool IsOfNext(const TriggerReceipt& next, const CapturedFrame& frame) const {
    return offset_ && frame.sequence >= next.number + *offset_ && frame.time >= next.time;
  }
  // False until a frame was matched, and after one was lost.
  [[nodiscard]] bool KnowsNumbers() const { return offset_.has_value(); }
  // The trigger stayed without a frame. Whether the driver counted it is unknown, so the next frame that fits in time
  // sets the difference anew.
  void TriggerLost() { offset_.reset(); }
  // Free running: the camera numbers its frames whether or not anybody waits. kNone: the first whole exposure after
  // `settled`; numbers that are missing before it belong, at the stream's even pace, to exposures before `settled`.
  // kOutOfOrder: it began before, keep waiting (a transition frame).
  [[nodiscard]] ShotFault MatchStream(MonotonicNs settled, std::chrono::nanoseconds window, const CapturedFrame& frame);
  // Numbers that a stream skipped where it does no harm, so far.
  [[nodiscard]] int64_t lost_in_transition() const { return lost_in_transition_; }
  // A frame that came while none was expected. kNone right after a lost trigger (it is that trigger's, too late).
  [[nodiscard]] ShotFault Unexpected(const CapturedFrame& frame);

 private:
  std::chrono::nanoseconds slack_;
  std::optional<int64_t> offset_;  // driver sequence - trigger number
  std::optional<int64_t> last_sequence_;
  MonotonicNs last_time_;  // free running: of that frame
  int64_t lost_in_transition_ = 0;
};

}  // namespace stratalux::rig
