// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/gather_kernel.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
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

// Adds the places of those of a vector's blocks, from (x, y) on, that are set.
HWY_INLINE void AddPlaces(hn::Mask<D> of, int x, int y, std::vector<BlockPlace>& places) {
  std::array<uint8_t, 8> bytes{};
  hn::StoreMaskBits(D(), of, bytes.data());
  for (unsigned bits = bytes[0] | unsigned{bytes[1]} << 8U; bits != 0; bits &= bits - 1)
    places.push_back({x + std::countr_zero(bits), y});
}

void SeeBlocks(const LitPlanes& planes, const BlockWindow& window, const TangentPlane& plane, float max_spread_mm2,
               SeenBlocks& seen) {
  const D d;
  const V none = hn::Zero(d), limit = hn::Set(d, max_spread_mm2);
  const auto set = [&](const std::array<float, 3>& v) {
    return std::array{hn::Set(d, v[0]), hn::Set(d, v[1]), hn::Set(d, v[2])};
  };
  const auto origin = set(plane.origin_mm), n = set(plane.normal), p = set(plane.p), q = set(plane.q);
  const int lanes = static_cast<int>(hn::Lanes(d)), columns = window.x1 - window.x0 + 1;
  V brightest = none;
  for (int y = window.y0; y <= window.y1; ++y) {
    const size_t from = static_cast<size_t>(y) * planes.stride + window.x0, to = seen.At(window.x0, y);
    for (int x = 0; x < columns; x += lanes) {
      const auto load = [&](const std::vector<float>& v) { return hn::LoadU(d, v.data() + from + x); };
      V flux = load(planes.flux);
      if (columns - x < lanes) flux = hn::IfThenElseZero(hn::FirstN(d, columns - x), flux);
      const auto store = [&](V v, std::vector<float>& into) { hn::StoreU(v, d, into.data() + to + x); };
      if (hn::AllTrue(d, hn::Eq(flux, none))) {  // where they lie is asked of none of them
        store(none, seen.flux);
        continue;
      }
      brightest = hn::Max(brightest, flux);
      const auto wide = hn::And(hn::Gt(flux, none), hn::Gt(load(planes.spread_mm2), limit));
      if (!hn::AllFalse(d, wide)) AddPlaces(wide, window.x0 + x, y, seen.wide);
      const V facing = Dot(n[0], n[1], n[2], load(planes.nx), load(planes.ny), load(planes.nz));
      flux = hn::IfThenZeroElse(hn::Or(wide, hn::Lt(facing, none)), flux);
      const V dx = hn::Sub(load(planes.x), origin[0]), dy = hn::Sub(load(planes.y), origin[1]),
              dz = hn::Sub(load(planes.z), origin[2]);
      store(Dot(p[0], p[1], p[2], dx, dy, dz), seen.p);
      store(Dot(q[0], q[1], q[2], dx, dy, dz), seen.q);
      const V off = Dot(n[0], n[1], n[2], dx, dy, dz);
      store(hn::Mul(off, off), seen.off2);
      store(flux, seen.flux);
    }
  }
  seen.dark = !(hn::GetLane(hn::MaxOfLanes(d, brightest)) > 0.0F);
}

float GatherBlocks(const SeenBlocks& seen, const BlockWindow& window, const GatherTarget& target) {
  const D d;
  const float per_mm2 = -target.half_inverse2 * std::numbers::log2e_v<float>;
  const V slope = hn::Set(d, per_mm2), most = hn::Set(d, -120.0F / per_mm2);
  const V at_p = hn::Set(d, target.p_mm), at_q = hn::Set(d, target.q_mm);
  const V none = hn::Zero(d);
  const int lanes = static_cast<int>(hn::Lanes(d)), columns = window.x1 - window.x0 + 1;
  V sum = none;
  const auto add = [&](V flux, const float* p, const float* q, const float* off2) {
    const V dp = hn::Sub(hn::LoadU(d, p), at_p), dq = hn::Sub(hn::LoadU(d, q), at_q);
    const V square = hn::MulAdd(dp, dp, hn::MulAdd(dq, dq, hn::LoadU(d, off2)));
    sum = hn::MulAdd(flux, PowerOfTwo(square, slope, most), sum);
  };
  for (int y = window.y0; y <= window.y1; ++y) {
    const size_t row = seen.At(window.x0, y);
    for (int x = 0; x < columns; x += lanes) {
      V flux = hn::LoadU(d, seen.flux.data() + row + x);
      if (columns - x < lanes) flux = hn::IfThenElseZero(hn::FirstN(d, columns - x), flux);
      if (hn::AllTrue(d, hn::Eq(flux, none))) continue;  // most of a stripe's surroundings are dark
      add(flux, seen.p.data() + row + x, seen.q.data() + row + x, seen.off2.data() + row + x);
    }
  }
  for (size_t k = 0; k < seen.part_flux.size(); k += lanes)
    add(hn::LoadU(d, seen.part_flux.data() + k), seen.part_p.data() + k, seen.part_q.data() + k,
        seen.part_off2.data() + k);
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

void SeenBlocks::AddPart(float p_mm, float q_mm, float off_mm, float part) {
  part_p.push_back(p_mm);
  part_q.push_back(q_mm);
  part_off2.push_back(off_mm * off_mm);
  part_flux.push_back(part);
}

void SeenBlocks::EndParts() {
  const size_t whole = (part_flux.size() + kGatherLanes - 1) / kGatherLanes * kGatherLanes;
  for (auto* parts : {&part_p, &part_q, &part_off2, &part_flux}) parts->resize(whole, 0.0F);
}

void SeeBlocks(const LitPlanes& planes, const BlockWindow& window, const TangentPlane& plane, float max_spread_mm2,
               SeenBlocks& seen) {
  seen.window = window;
  seen.stride = window.x1 - window.x0 + 1 + kGatherLanes;
  const size_t size = static_cast<size_t>(seen.stride) * (window.y1 - window.y0 + 1) + kGatherLanes;
  for (auto* plane_of : {&seen.p, &seen.q, &seen.off2, &seen.flux})
    if (plane_of->size() < size) plane_of->resize(size);
  seen.wide.clear();
  for (auto* parts : {&seen.part_p, &seen.part_q, &seen.part_off2, &seen.part_flux}) parts->clear();
  HWY_DYNAMIC_DISPATCH(SeeBlocks)(planes, window, plane, max_spread_mm2, seen);
}

float GatherBlocks(const SeenBlocks& seen, const BlockWindow& window, const GatherTarget& target) {
  return HWY_DYNAMIC_DISPATCH(GatherBlocks)(seen, window, target);
}

}  // namespace stratalux::fit
#endif
