// SPDX-License-Identifier: Apache-2.0
// What the visitor sees of themselves while they find their place.
#pragma once

#include <string>

#include "shared/base/result.h"
#include "shared/capture/frame_record.h"
#include "shared/image/image.h"

namespace stratalux::rig {

// A grey JPEG, in memory alone, at most `limit_px` wide and high: grey, since a mosaic without a white balance gives
// people a sickly green; as bright as the frame's brightest hundredth allows, since the room's light is weak.
[[nodiscard]] Result<std::string> PreviewPicture(const FrameRecord& record, ImageView<const uint16_t> frame,
                                                 int limit_px = 640);

}  // namespace stratalux::rig
