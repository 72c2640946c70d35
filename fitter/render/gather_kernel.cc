// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/gather_kernel.h"

#include <algorithm>
#include <numbers>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitter/render/gather_kernel.cc"
#include "fitter/mixture/highway_targets.h"

HWY_BEFORE_NAMESPACE();
namespace stratalux::fit {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, kGatherLanes>;
using V = hn::Vec<D>;

// 2^(square slope) for square >= 0 > slope; 2^-120 where it were less.
//
// 2^n, n whole, times the polynomial of degree 5 that meets 2^r at the Chebyshev nodes of |r| <= 1/2: its error is at
// most max |d^6 2^r / dr^6| / 6! 2 (1/4)^6 = 1.1e-7, relative 1.5e-7, beside single precision's 6e-8 a step.
HWY_INLINE V PowerOfTwo(V square, V slope, V most) {
  const D d;
  const hn::RebindToSigned<D> whole;
  square = hn::Min(square, most);  // 120 / -slope
  // Adding 1.5 2^23 rounds to whole numbers, which then stand in the lowest bits.
  const V rounding = hn::Set(d, 12582912.0F);
  const V rounded = hn::MulAdd(square, slope, rounding);
  const V r = hn::MulSub(square, slope, hn::Sub(rounded, rounding));
  V p = hn::MulAdd(hn::Set(d, 1.339086336e-3F), r, hn::Set(d, 9.676031918e-3F));
  for (const float coefficient : {5.550357114e-2F, 2.402210749e-1F, 6.931471880e-1F, 1.000000075F})
    p = hn::MulAdd(p, r, hn::Set(d, coefficient));
  return hn::BitCast(d, hn::Add(hn::BitCast(whole, p), hn::ShiftLeft<23>(hn::BitCast(whole, rounded))));
}

// a . b
HWY_INLINE V Dot(V ax, V ay, V az, V bx, V by, V bz) { return hn::MulAdd(az, bz, hn::MulAdd(ax, bx, hn::Mul(ay, by))); }

void SeeBlocks(const LitPlanes& planes, const BlockWindow& window, const TangentPlane& plane, SeenBlocks& seen) {
  const D d;
  const V none = hn::Zero(d);
  const auto set = [&](const std::array<float, 3>& v) {
    return std::array{hn::Set(d, v[0]), hn::Set(d, v[1]), hn::Set(d, v[2])};
  };
  const auto origin = set(plane.origin_mm), n = set(plane.normal), p = set(plane.p), q = set(plane.q);
  const int lanes = static_cast<int>(hn::Lanes(d)), columns = window.x1 - window.x0 + 1;
  V widest = none, brightest = none;
  for (int y = window.y0; y <= window.y1; ++y) {
    const size_t from = static_cast<size_t>(y) * planes.stride + window.x0, to = seen.At(window.x0, y);
    for (int x = 0; x < columns; x += lanes) {
      const auto load = [&](const std::vector<float>& v) { return hn::LoadU(d, v.data() + from + x); };
      V flux = load(planes.flux);
      if (columns - x < lanes) flux = hn::IfThenElseZero(hn::FirstN(d, columns - x), flux);
      const auto store = [&](V v, std::vector<float>& into) { hn::StoreU(v, d, into.data() + to + x); };
      if (hn::AllTrue(d, hn::Eq(flux, none))) {  // where they lie is asked of none of them
        store(none, seen.flux);
        store(none, seen.spread_mm2);
        continue;
      }
      const V spread = hn::IfThenElseZero(hn::Gt(flux, none), load(planes.spread_mm2));
      widest = hn::Max(widest, spread);
      brightest = hn::Max(brightest, flux);
      const V facing = Dot(n[0], n[1], n[2], load(planes.nx), load(planes.ny), load(planes.nz));
      flux = hn::IfThenZeroElse(hn::Lt(facing, none), flux);
      const V dx = hn::Sub(load(planes.x), origin[0]), dy = hn::Sub(load(planes.y), origin[1]),
              dz = hn::Sub(load(planes.z), origin[2]);
      store(Dot(p[0], p[1], p[2], dx, dy, dz), seen.p);
      store(Dot(q[0], q[1], q[2], dx, dy, dz), seen.q);
      store(flux, seen.flux);
      store(spread, seen.spread_mm2);
    }
  }
  seen.widest_mm2 = hn::GetLane(hn::MaxOfLanes(d, widest));
  seen.dark = !(hn::GetLane(hn::MaxOfLanes(d, brightest)) > 0.0F);
}

float GatherBlocks(const SeenBlocks& seen, const BlockWindow& window, const GatherTarget& target) {
  const D d;
  const float per_mm2 = -target.half_inverse2 * std::numbers::log2e_v<float>;
  const V slope = hn::Set(d, per_mm2), most = hn::Set(d, -120.0F / per_mm2);
  const V at_p = hn::Set(d, target.p_mm), at_q = hn::Set(d, target.q_mm);
  const V none = hn::Zero(d), limit = hn::Set(d, target.max_spread_mm2);
  const bool some_left_out = seen.widest_mm2 > target.max_spread_mm2;
  const int lanes = static_cast<int>(hn::Lanes(d)), columns = window.x1 - window.x0 + 1;
  V sum = none;
  for (int y = window.y0; y <= window.y1; ++y) {
    const size_t row = seen.At(window.x0, y);
    for (int x = 0; x < columns; x += lanes) {
      const auto load = [&](const std::vector<float>& v) { return hn::LoadU(d, v.data() + row + x); };
      V flux = load(seen.flux);
      if (columns - x < lanes) flux = hn::IfThenElseZero(hn::FirstN(d, columns - x), flux);
      if (hn::AllTrue(d, hn::Eq(flux, none))) continue;  // most of a stripe's surroundings are dark
      if (some_left_out) flux = hn::IfThenZeroElse(hn::Gt(load(seen.spread_mm2), limit), flux);
      const V dp = hn::Sub(load(seen.p), at_p), dq = hn::Sub(load(seen.q), at_q);
      sum = hn::MulAdd(flux, PowerOfTwo(hn::MulAdd(dp, dp, hn::Mul(dq, dq)), slope, most), sum);
    }
  }
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

}  // namespace HWY_NAMESPACE
}  // namespace stratalux::fit
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stratalux::fit {

HWY_EXPORT(SeeBlocks);
HWY_EXPORT(GatherBlocks);

BlockWindow BlockWindow::With(const BlockWindow& other) const {
  if (Empty()) return other;
  if (other.Empty()) return *this;
  return {std::min(x0, other.x0), std::max(x1, other.x1), std::min(y0, other.y0), std::max(y1, other.y1)};
}

BlockWindow BlockWindow::Within(const BlockWindow& other) const {
  return {std::max(x0, other.x0), std::min(x1, other.x1), std::max(y0, other.y0), std::min(y1, other.y1)};
}

void SeeBlocks(const LitPlanes& planes, const BlockWindow& window, const TangentPlane& plane, SeenBlocks& seen) {
  seen.window = window;
  seen.stride = window.x1 - window.x0 + 1 + kGatherLanes;
  const size_t size = static_cast<size_t>(seen.stride) * (window.y1 - window.y0 + 1) + kGatherLanes;
  for (auto* plane_of : {&seen.p, &seen.q, &seen.flux, &seen.spread_mm2})
    if (plane_of->size() < size) plane_of->resize(size);
  HWY_DYNAMIC_DISPATCH(SeeBlocks)(planes, window, plane, seen);
}

float GatherBlocks(const SeenBlocks& seen, const BlockWindow& window, const GatherTarget& target) {
  return HWY_DYNAMIC_DISPATCH(GatherBlocks)(seen, window, target);
}

}  // namespace stratalux::fit
#endif
