// SPDX-License-Identifier: Apache-2.0
// What a frame header may say (docs/file-formats.md). Its hash proves that nobody changed it since; this, that it makes
// sense: asked wherever headers enter the index or become frames.
#pragma once

#include "db/segment/segment.h"
#include "shared/base/result.h"

namespace stratalux::db {

enum class RecordKind { kFrame, kTruthMap };  // of frames-NNNN.seg, of truth.seg

// kNewerSchema for a value that a later version may have given a meaning (an unknown phase, codec, cipher, ...).
// kIntegrity for what no version writes: numbers that are no numbers, sizes that no payload of this length has, texts
// without an end. Names the frame.
[[nodiscard]] Status CheckHeader(const FrameHeader& header, RecordKind kind = RecordKind::kFrame);

}  // namespace stratalux::db
