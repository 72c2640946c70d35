// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/events/start_button.h"

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

MonotonicNs At(double ms) { return MonotonicNs{} + FromMilliseconds(ms); }

// A button seen as the lines' watcher sees it: each edge to active, and the level once in 50 ms.
struct Watched {
  StartButton button;
  int presses = 0;
  void Rest(double from_ms, double to_ms) {
    for (double ms = from_ms; ms < to_ms; ms += 50.0) button.OnRest(At(ms));
  }
  void Held(double from_ms, double to_ms) {
    for (double ms = from_ms; ms < to_ms; ms += 50.0) button.OnHeld();
  }
  void Edge() { presses += button.OnEdge(); }
};

TEST(StartButton, APressIsOneHoweverItBouncesAndHoweverLongItIsHeld) {
  Random random(5);
  Watched line;
  double ms = 0.0;
  for (int press = 1; press <= 200; ++press) {
    line.Rest(ms, ms + 200.0);
    ms += 200.0;
    for (int bounce = 0; bounce <= static_cast<int>(random.Uniform(0, 20)); ++bounce) line.Edge();
    EXPECT_EQ(line.presses, press);
    const double held = random.Uniform(1.0, 10000.0);
    line.Held(ms, ms + held);
    ms += held;
    // Let go: a look may fall between two bounces, and find it at rest.
    for (int bounce = 0; bounce <= static_cast<int>(random.Uniform(0, 20)); ++bounce) {
      line.Edge();
      if (random.Uniform(0, 1) < 0.3) line.button.OnRest(At(ms));
      ms += random.Uniform(0.0, 5.0);
    }
    EXPECT_EQ(line.presses, press) << "letting go is no press";
  }
}

TEST(StartButton, OneThatIsHeldWhenTheProgramBeginsIsNoPressUntilItWasLetGo) {
  Watched line;
  line.Held(0, 300);
  line.Edge();
  EXPECT_EQ(line.presses, 0);
  line.button.OnRest(At(400));
  line.Edge();
  EXPECT_EQ(line.presses, 0) << "at rest for a moment only";
  line.Rest(450, 600);
  line.Edge();
  EXPECT_EQ(line.presses, 1);
}

}  // namespace
}  // namespace stratalux::rig
