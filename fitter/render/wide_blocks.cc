// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/wide_blocks.h"

#include <array>
#include <bit>
#include <cstdint>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitter/render/wide_blocks.cc"
#include "fitter/mixture/highway_targets.h"

HWY_BEFORE_NAMESPACE();
namespace stratalux::fit {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void FindWideBlocks(const SeenBlocks& seen, const BlockWindow& window, float max_spread_mm2,
                    std::vector<BlockPlace>& wide) {
  const hn::CappedTag<float, kGatherLanes> d;
  const auto limit = hn::Set(d, max_spread_mm2);
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int y = window.y0; y <= window.y1; ++y) {
    const float* row = seen.spread_mm2.data() + seen.At(window.x0, y);
    for (int x = window.x0; x <= window.x1; x += lanes) {
      const auto wider = hn::Gt(hn::LoadU(d, row + (x - window.x0)), limit);
      if (hn::AllFalse(d, wider)) continue;
      std::array<uint8_t, 8> bytes{};
      hn::StoreMaskBits(d, wider, bytes.data());
      unsigned bits = bytes[0] | unsigned{bytes[1]} << 8U;
      if (window.x1 - x + 1 < kGatherLanes) bits &= (1U << static_cast<unsigned>(window.x1 - x + 1)) - 1U;
      for (; bits != 0; bits &= bits - 1) wide.push_back({x + std::countr_zero(bits), y});
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace stratalux::fit
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stratalux::fit {

HWY_EXPORT(FindWideBlocks);

void FindWideBlocks(const SeenBlocks& seen, const BlockWindow& window, float max_spread_mm2,
                    std::vector<BlockPlace>& wide) {
  wide.clear();
  HWY_DYNAMIC_DISPATCH(FindWideBlocks)(seen, window, max_spread_mm2, wide);
}

}  // namespace stratalux::fit
#endif
