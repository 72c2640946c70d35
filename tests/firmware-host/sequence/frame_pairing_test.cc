// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/frame_pairing.h"

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using std::chrono::milliseconds;

TriggerReceipt Trigger(int64_t number) { return {number, MonotonicNs{number * 100'000'000}}; }
CapturedFrame Frame(int64_t sequence, const TriggerReceipt& trigger, milliseconds delay) {
  CapturedFrame frame;
  frame.sequence = sequence;
  frame.time = trigger.time + delay;
  return frame;
}

TEST(FramePairing, AcceptsAConstantDifferenceOfNumbers) {
  FramePairing pairing(milliseconds(10));
  for (int n = 1; n < 5; ++n)
    EXPECT_EQ(pairing.Match(Trigger(n), 16.0, Frame(n + 41, Trigger(n), milliseconds(1))), ShotFault::kNone);
}

TEST(FramePairing, TheWindowIsExposurePlusSlack) {
  FramePairing pairing(milliseconds(10));
  EXPECT_EQ(pairing.Match(Trigger(1), 16.0, Frame(1, Trigger(1), milliseconds(26))), ShotFault::kNone);
  EXPECT_EQ(pairing.Match(Trigger(2), 16.0, Frame(2, Trigger(2), milliseconds(27))), ShotFault::kLateFrame);
}

TEST(FramePairing, AJumpOfTheNumberIsAGapOnce) {
  FramePairing pairing(milliseconds(10));
  EXPECT_EQ(pairing.Match(Trigger(1), 16.0, Frame(1, Trigger(1), milliseconds(1))), ShotFault::kNone);
  EXPECT_EQ(pairing.Match(Trigger(2), 16.0, Frame(3, Trigger(2), milliseconds(1))), ShotFault::kSequenceGap);
  EXPECT_EQ(pairing.Match(Trigger(3), 16.0, Frame(4, Trigger(3), milliseconds(1))), ShotFault::kNone);
}

TEST(FramePairing, AFrameFromBeforeTheTriggerIsNeverItsOwn) {
  FramePairing pairing(milliseconds(10));
  EXPECT_EQ(pairing.Match(Trigger(1), 16.0, Frame(1, Trigger(1), milliseconds(-1))), ShotFault::kOutOfOrder);
}

TEST(FramePairing, AfterALossEitherCountOfTheDriverFits) {
  for (int counted : {0, 1}) {
    FramePairing pairing(milliseconds(10));
    EXPECT_EQ(pairing.Match(Trigger(1), 16.0, Frame(1, Trigger(1), milliseconds(1))), ShotFault::kNone);
    pairing.TriggerLost();
    EXPECT_EQ(pairing.Match(Trigger(3), 16.0, Frame(2 + counted, Trigger(3), milliseconds(1))), ShotFault::kNone);
  }
}

TEST(FramePairing, ARepeatedNumberIsDoubled) {
  FramePairing pairing(milliseconds(10));
  const CapturedFrame frame = Frame(1, Trigger(1), milliseconds(1));
  EXPECT_EQ(pairing.Match(Trigger(1), 16.0, frame), ShotFault::kNone);
  EXPECT_EQ(pairing.Match(Trigger(2), 16.0, frame), ShotFault::kDoubledFrame);
  EXPECT_EQ(pairing.Unexpected(frame), ShotFault::kDoubledFrame);
}

}  // namespace
}  // namespace stratalux::rig
