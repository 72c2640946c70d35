// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/mixture/fma_peak.h"

#include <benchmark/benchmark.h>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "tests/bench/mixture/fma_peak.cc"
#include "fitter/mixture/highway_targets.h"

HWY_BEFORE_NAMESPACE();
namespace stratalux::bench {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

int64_t MultiplyAdds(int64_t rounds) {
  const hn::CappedTag<float, 16> d;
  using V = hn::Vec<decltype(d)>;
  constexpr int kChains = 12;
  const V a = hn::Set(d, 0.999F), b = hn::Set(d, 0.001F);
  V x[kChains];
  for (int i = 0; i < kChains; ++i) x[i] = hn::Set(d, static_cast<float>(i));
  for (int64_t r = 0; r < rounds; ++r)
    for (int i = 0; i < kChains; ++i) x[i] = hn::MulAdd(x[i], a, b);
  V sum = hn::Zero(d);
  for (int i = 0; i < kChains; ++i) sum = hn::Add(sum, x[i]);
  float result = hn::GetLane(hn::SumOfLanes(d, sum));
  benchmark::DoNotOptimize(result);
  return rounds * kChains * static_cast<int64_t>(hn::Lanes(d));
}

}  // namespace HWY_NAMESPACE
}  // namespace stratalux::bench
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stratalux::bench {
HWY_EXPORT(MultiplyAdds);
int64_t MultiplyAdds(int64_t rounds) { return HWY_DYNAMIC_DISPATCH(MultiplyAdds)(rounds); }
}  // namespace stratalux::bench
#endif
