// SPDX-License-Identifier: Apache-2.0
// What light_off_bench measures, a row a cause: from the moment that light must go off to the last ENABLE line that was
// written off, on the scripted lines.
#pragma once

#include <cstdint>
#include <vector>

namespace stratalux::rig {

class Row {
 public:
  // One moment, by CLOCK_MONOTONIC; `dark`: every light is off by now.
  void Add(bool dark, int64_t due_ns);
  void Print(const char* what, const char* cause);

 private:
  std::vector<double> ms_;
  int never_ = 0;
};

// A process with both lights on, its main thread at work at an ordinary priority, gets a signal: each fatal one in
// turn, INT and TERM. It must die by it and leave no light.
[[nodiscard]] Row MeasureSignals(int deaths);
// The same process has a thread that faults: a row a way. The clock runs from the statement before, of an exception
// from std::terminate. Where other threads take the processor between that and the fault, the death itself comes later.
void MeasureFaults(const char* what, int deaths);

}  // namespace stratalux::rig
