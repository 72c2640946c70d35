// SPDX-License-Identifier: Apache-2.0
// How a rig's store is asked to code its frames: the `[store] codec` of rig.toml. What a frame was really coded with
// stands in its header (docs/file-formats.md).
#pragma once

#include <string>

#include "shared/base/result.h"

namespace stratalux {

enum class StoreCodec {
  kRaw12,  // packed samples: the least work
  kDelta,  // predicted and compressed, lossless
};

[[nodiscard]] constexpr const char* ToString(StoreCodec codec) {
  return codec == StoreCodec::kRaw12 ? "raw12" : "delta";
}
// kUsage, naming what is allowed.
[[nodiscard]] inline Result<StoreCodec> ParseStoreCodec(const std::string& text) {
  for (const StoreCodec codec : {StoreCodec::kRaw12, StoreCodec::kDelta})
    if (text == ToString(codec)) return codec;
  return Status::Usage("unknown codec '" + text + "' (allowed: raw12, delta)");
}

}  // namespace stratalux
