// SPDX-License-Identifier: Apache-2.0
// The kernel's GPIO lines without a library's types. For gpio/ and the list of devices (apps/device_list.h).
//
// Chips and outputs go through libgpiod, 1.6 or 2.x. Inputs go through the kernel's own interface (linux/gpio.h, v2),
// since libgpiod 1.6 hides the numbers by which a lost edge is seen, and its 16 events are soon full.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "firmware-host/gpio/line_search.h"
#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::rig {

// Device nodes of all chips, sorted.
[[nodiscard]] std::vector<std::string> ChipPaths();
// The chip behind a node and its lines as they are now; takes none. 0, or errno of a chip that cannot be opened.
[[nodiscard]] int DescribeChip(const std::string& path, GpioChip& chip);
// All chips that this user may open.
[[nodiscard]] std::vector<GpioChip> ListChips();

// Levels are electrical, one bit a line in the order of the request: bit i set = line i high.
class OutputRequest {
 public:
  virtual ~OutputRequest() = default;
  // 0 or errno. Allocates nothing and takes no lock: safe in a signal handler.
  virtual int Write(uint64_t levels) noexcept = 0;
  // 0 or errno; the levels that the lines have.
  virtual int Read(uint64_t& levels) noexcept = 0;
};

// At most 64 lines of one chip, at `levels` from the start. kBusy: somebody else has one of them.
[[nodiscard]] Result<std::unique_ptr<OutputRequest>> RequestOutputs(const std::string& chip_path,
                                                                    const std::vector<unsigned>& offsets,
                                                                    uint64_t levels);

struct InputLine {
  unsigned offset = 0;
  ActiveLevel active = ActiveLevel::kHigh;
  LineBias bias = LineBias::kAsIs;
  std::chrono::microseconds debounce{0};
};

// A line became active.
struct LineEvent {
  size_t line = 0;           // in the order of the request
  uint32_t line_number = 0;  // counts this line's events from 1, those the kernel had to drop included; wraps
  MonotonicNs time;
};

class InputRequest {
 public:
  virtual ~InputRequest() = default;
  // Readable when events wait.
  [[nodiscard]] virtual int fd() const = 0;
  // What waits, oldest first; empty when nothing does. kFailed: the chip is gone.
  virtual Result<std::vector<LineEvent>> Read() = 0;
  // Bit i set: line i is active.
  virtual Result<uint64_t> ReadActive() = 0;
  // Reads all that waits away. 0 or errno; bit i of `seen`: line i became active meanwhile; of `active`: is active now.
  // Allocates nothing.
  virtual int Take(uint64_t& seen, uint64_t& active) noexcept = 0;
};

[[nodiscard]] Result<std::unique_ptr<InputRequest>> RequestInputs(const std::string& chip_path,
                                                                  const std::vector<InputLine>& lines);

}  // namespace stratalux::rig
