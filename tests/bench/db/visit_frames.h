// SPDX-License-Identifier: Apache-2.0
// Frames of a session for the benchmarks: the latest of the store that $STRATALUX_BENCH_STORE names.
#pragma once

#include <vector>

#include "shared/base/result.h"
#include "shared/capture/frame_record.h"
#include "shared/image/image.h"

namespace stratalux::bench {

struct VisitFrame {
  FrameRecord record;
  Image<uint16_t> pixels;
};

// At most `most` frames, evenly over the whole session, so that each phase has its share.
[[nodiscard]] Result<std::vector<VisitFrame>> LoadVisit(size_t most);

}  // namespace stratalux::bench
