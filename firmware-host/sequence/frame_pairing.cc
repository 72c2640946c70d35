// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/frame_pairing.h"

#include <algorithm>

namespace stratalux::rig {

ShotFault FramePairing::Match(const TriggerReceipt& trigger, double exposure_ms, const CapturedFrame& frame) {
  if (last_sequence_ && frame.sequence == *last_sequence_) return ShotFault::kDoubledFrame;
  if (last_sequence_ && frame.sequence < *last_sequence_) return ShotFault::kOutOfOrder;
  last_sequence_ = frame.sequence;
  if (frame.time < trigger.time) {
    offset_.reset();
    return ShotFault::kOutOfOrder;
  }
  const int64_t offset = frame.sequence - trigger.number;
  const bool gap = offset_ && offset != *offset_;
  offset_ = offset;
  if (gap) return ShotFault::kSequenceGap;
  const auto window = FromMilliseconds(exposure_ms) + slack_;
  if (frame.time > trigger.time + window) return ShotFault::kLateFrame;
  return frame.corrupt ? ShotFault::kCorruptFrame : ShotFault::kNone;
}

ShotFault FramePairing::MatchStream(MonotonicNs settled, std::chrono::nanoseconds window, const CapturedFrame& frame) {
  if (last_sequence_ && frame.sequence == *last_sequence_) return ShotFault::kDoubledFrame;
  if (last_sequence_ && frame.sequence < *last_sequence_) return ShotFault::kOutOfOrder;
  const int64_t missing = last_sequence_ ? frame.sequence - *last_sequence_ - 1 : 0;
  const std::chrono::nanoseconds period = (frame.time - last_time_) / (missing + 1);
  last_sequence_ = frame.sequence;
  last_time_ = frame.time;
  if (frame.time < settled) {
    lost_in_transition_ += missing;
    return ShotFault::kOutOfOrder;
  }
  if (missing > 0) {
    // Buffers run over while nobody reads, as when a memory is stepped: that harms no exposure before `settled`.
    if (frame.time - settled > period) return ShotFault::kSequenceGap;
    lost_in_transition_ += missing;
  }
  if (frame.time > settled + window) return ShotFault::kLateFrame;
  return frame.corrupt ? ShotFault::kCorruptFrame : ShotFault::kNone;
}

ShotFault FramePairing::Unexpected(const CapturedFrame& frame) {
  const bool after_loss = !offset_;
  const bool stale = last_sequence_ && frame.sequence < *last_sequence_;
  last_sequence_ = std::max(last_sequence_.value_or(frame.sequence), frame.sequence);
  if (after_loss) return ShotFault::kNone;
  if (stale) return ShotFault::kOutOfOrder;
  // An exposure nobody asked for moves the driver's numbers, so the next frame sets the difference anew.
  offset_.reset();
  return ShotFault::kDoubledFrame;
}

}  // namespace stratalux::rig
