// SPDX-License-Identifier: Apache-2.0
// Runs a body once for each instruction set that both the EM kernels and this machine have.
#pragma once

#include <cstdint>

#include <hwy/highway.h>
#include <hwy/targets.h>

namespace stratalux::fit {

// 0: back to the machine's best.
inline void ChooseSimdTarget(int64_t target) {
  hwy::SetSupportedTargetsForTest(target);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

template <typename Body>
void ForEachSimdTarget(const Body& body) {
  for (int64_t target : {HWY_AVX3, HWY_AVX2, HWY_SSE4, HWY_NEON}) {
    if ((hwy::SupportedTargets() & target) == 0) continue;
    ChooseSimdTarget(target);
    body(hwy::TargetName(target));
    ChooseSimdTarget(0);
  }
}

}  // namespace stratalux::fit
