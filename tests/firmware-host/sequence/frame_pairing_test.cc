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

TEST(FramePairing, AStreamMayLoseWhatBeganBeforeItSettled) {
  // 50 frames a second; frame k begins at 20 k ms.
  const auto frame = [](int64_t k) {
    CapturedFrame f;
    f.sequence = k;
    f.time = {20'000'000 * k};
    return f;
  };
  const auto settled = [](int64_t ms) { return MonotonicNs{1'000'000 * ms}; };
  constexpr auto kWindow = std::chrono::seconds(1);
  FramePairing pairing(std::chrono::milliseconds(5));
  EXPECT_EQ(pairing.MatchStream(settled(15), kWindow, frame(0)), ShotFault::kOutOfOrder);
  EXPECT_EQ(pairing.MatchStream(settled(15), kWindow, frame(1)), ShotFault::kNone);
  // Buffers ran over: 2 .. 9 are lost, and the light settled at 195 ms, while frame 9 was exposed.
  EXPECT_EQ(pairing.MatchStream(settled(195), kWindow, frame(10)), ShotFault::kNone);
  EXPECT_EQ(pairing.lost_in_transition(), 8);
  // Frame 11 began at 220 ms, after 215: it was the one wanted, and it is lost.
  EXPECT_EQ(pairing.MatchStream(settled(215), kWindow, frame(12)), ShotFault::kSequenceGap);
  EXPECT_EQ(pairing.lost_in_transition(), 8);
}

}  // namespace
}  // namespace stratalux::rig
