// SPDX-License-Identifier: Apache-2.0
// StartButton: presses out of the edges and levels of a line that bounces. Pure.
#pragma once

#include <optional>

#include "shared/units/time.h"

namespace stratalux::rig {

class StartButton {
 public:
  // For so long it was seen at rest, without an edge between, before an edge is a press again: longer than any contact
  // bounces, also when it is let go.
  static constexpr std::chrono::milliseconds kQuiet{40};

  // It became active. True: a press. A line that was held when the program began gives none until it was let go.
  [[nodiscard]] bool OnEdge();
  // How the line is; to be told more than once a kQuiet or so. Bounces may hide between two looks, their edges do not.
  void OnRest(MonotonicNs time);
  void OnHeld() { quiet_since_.reset(); }

 private:
  bool armed_ = false;
  std::optional<MonotonicNs> quiet_since_;
};

}  // namespace stratalux::rig
