// SPDX-License-Identifier: Apache-2.0
// DisplayLineBank: lets displays be stepped like pattern memories, so that the sequencer knows but one kind.
//
// TRIGGER of a display is a flip to its next pattern; its SYNC edge is the flip's vertical blank plus the display's
// latency (from there to the light, calibrated). Everything else goes to the bank of real lines.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <vector>

#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/projector/display.h"

namespace stratalux::rig {

struct DisplayOfProjector {
  Display* display = nullptr;  // null: the projector has a TRIGGER line
  std::chrono::nanoseconds latency{0};
};

class DisplayLineBank : public LineBank {
 public:
  // `displays`: one entry a projector, in the rig's order. `lines`: null on a rig without real lines. Both outlive it.
  DisplayLineBank(LineBank* lines, std::vector<DisplayOfProjector> displays);

  Result<TriggerReceipt> TriggerProjector(int projector) override;
  // kFailed on a rig without lines: its camera runs free.
  Result<TriggerReceipt> TriggerCamera() override;
  Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds timeout) override;
  [[nodiscard]] std::optional<MonotonicNs> LastStrobe() override;

 private:
  struct Channel {
    DisplayOfProjector wiring;
    bool pending = false;  // a flip was asked for and has not been seen
    int64_t edges = 0;
  };
  Status Flip(Channel& channel);
  // The display edge that is due first, once its light is on; nullopt at the deadline.
  Result<std::optional<SyncEdge>> WaitEdge(std::chrono::steady_clock::time_point deadline);
  [[nodiscard]] bool AnyPending() const;

  LineBank* lines_;
  std::vector<Channel> channels_;
  std::deque<SyncEdge> edges_;  // of flips that are done, their light not on yet; by time
  int64_t triggers_ = 0;
};

}  // namespace stratalux::rig
