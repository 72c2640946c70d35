// SPDX-License-Identifier: Apache-2.0
// Frames as small pictures for a screen.
#pragma once

#include <cstdint>

#include "shared/capture/frame_record.h"
#include "shared/image/image.h"

namespace stratalux {

// sRGB, at most `limit_px` wide and high: means over blocks of the frame's linear values, a mosaic's colours each by
// itself; the format's largest value is white. An image of at most that size keeps it.
[[nodiscard]] Image<uint8_t> ReducedPicture(const FrameRecord& record, ImageView<const uint16_t> frame, int limit_px);

}  // namespace stratalux
