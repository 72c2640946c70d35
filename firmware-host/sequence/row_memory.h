// SPDX-License-Identifier: Apache-2.0
// RowMemory: sees a frame that repeats rows of an earlier one, as a frozen buffer or a torn transfer does.
#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "shared/image/image.h"

namespace stratalux::rig {

// The noise of a real camera never repeats: two frames whose rows agree in 32 pixels spread over the row, bit by bit,
// are one exposure. Rows of one value (saturated, or dark beyond the converter's range) say nothing, nor do those with
// a few samples beside it: at the edge of a saturated white target.
class RowMemory {
 public:
  // Share of the rows of `pixels` that repeat the same row of one of the last 16 frames, which must be of its size;
  // then remembers `pixels`.
  double ShareRepeated(const Image<uint16_t>& pixels);

 private:
  std::deque<std::vector<uint64_t>> frames_;  // a number for each row, the newest frame last; 0: a row of one value
};

}  // namespace stratalux::rig
