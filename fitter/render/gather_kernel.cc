// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/gather_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitter/render/gather_kernel.cc"
#include "fitter/mixture/highway_targets.h"

HWY_BEFORE_NAMESPACE();
namespace stratalux::fit {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, kGatherLanes>;
using V = hn::Vec<D>;

// e^x, relative error 2e-7: 2^n times a polynomial of the remainder; 0 below -80, held at e^60 above.
HWY_INLINE V Exp(V x) {
  const D d;
  const hn::RebindToSigned<D> whole;
  const auto vanishes = hn::Lt(x, hn::Set(d, -80.0F));
  x = hn::IfThenElse(vanishes, hn::Set(d, -80.0F), x);
  x = hn::IfThenElse(hn::Gt(x, hn::Set(d, 60.0F)), hn::Set(d, 60.0F), x);
  const V t = hn::Mul(x, hn::Set(d, 1.44269504F));
  const V half = hn::IfThenElse(hn::Lt(t, hn::Zero(d)), hn::Set(d, -0.5F), hn::Set(d, 0.5F));
  const auto n = hn::ConvertTo(whole, hn::Add(t, half));
  const V fn = hn::ConvertTo(d, n);
  const V r = hn::NegMulAdd(fn, hn::Set(d, 1.42860677e-6F), hn::NegMulAdd(fn, hn::Set(d, 0.693145752F), x));
  V p = hn::MulAdd(hn::Set(d, 1.38889e-3F), r, hn::Set(d, 8.33333e-3F));
  for (const float coefficient : {4.1666666e-2F, 1.6666667e-1F, 0.5F, 1.0F, 1.0F})
    p = hn::MulAdd(p, r, hn::Set(d, coefficient));
  const V scale = hn::BitCast(d, hn::ShiftLeft<23>(hn::Add(n, hn::Set(whole, 127))));
  return hn::IfThenZeroElse(vanishes, hn::Mul(p, scale));
}

// a . b
HWY_INLINE V Dot(V ax, V ay, V az, V bx, V by, V bz) { return hn::MulAdd(az, bz, hn::MulAdd(ax, bx, hn::Mul(ay, by))); }

Gathered GatherBlocks(const LitPlanes& planes, int x0, int x1, int y0, int y1, const GatherTarget& target) {
  const D d;
  const V none = hn::Zero(d), limit = hn::Set(d, target.max_spread_mm2), slope = hn::Set(d, -target.half_inverse2);
  const V nx = hn::Set(d, target.normal[0]), ny = hn::Set(d, target.normal[1]), nz = hn::Set(d, target.normal[2]);
  const V cx = hn::Set(d, target.centre_mm[0]), cy = hn::Set(d, target.centre_mm[1]),
          cz = hn::Set(d, target.centre_mm[2]);
  HWY_ALIGN float sums[kGatherLanes], spreads[kGatherLanes];
  for (int first = 0; first < kGatherLanes; first += static_cast<int>(hn::Lanes(d))) {
    const V lane = hn::Iota(d, static_cast<float>(first));
    V sum = none, widest = none;
    for (int y = y0; y <= y1; ++y) {
      const size_t row = static_cast<size_t>(y) * planes.stride + first;
      for (int x = x0; x <= x1; x += kGatherLanes) {
        const auto load = [&](const std::vector<float>& plane) { return hn::LoadU(d, plane.data() + row + x); };
        V flux =
            hn::IfThenElseZero(hn::Le(lane, hn::Set(d, static_cast<float>(x1 - x))), load(planes.flux[target.channel]));
        if (hn::AllTrue(d, hn::Eq(flux, none))) continue;  // most of a stripe's surroundings are dark
        const V spread = load(planes.spread_mm2);
        const V lit_spread = hn::IfThenElseZero(hn::Gt(flux, none), spread);
        widest = hn::IfThenElse(hn::Gt(lit_spread, widest), lit_spread, widest);
        flux = hn::IfThenZeroElse(hn::Gt(spread, limit), flux);
        const V facing = Dot(nx, ny, nz, load(planes.nx), load(planes.ny), load(planes.nz));
        flux = hn::IfThenZeroElse(hn::Lt(facing, none), flux);
        const V dx = hn::Sub(load(planes.x), cx), dy = hn::Sub(load(planes.y), cy), dz = hn::Sub(load(planes.z), cz);
        const V along = Dot(nx, ny, nz, dx, dy, dz);
        const V across2 = hn::NegMulAdd(along, along, Dot(dx, dy, dz, dx, dy, dz));
        sum = hn::MulAdd(flux, Exp(hn::Mul(slope, across2)), sum);
      }
    }
    hn::Store(sum, d, sums + first);
    hn::Store(widest, d, spreads + first);
  }
  Gathered gathered;
  for (int i = 0; i < kGatherLanes; ++i) {
    gathered.sum += sums[i];
    gathered.left_out = gathered.left_out || spreads[i] > target.max_spread_mm2;
  }
  return gathered;
}

}  // namespace HWY_NAMESPACE
}  // namespace stratalux::fit
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stratalux::fit {

HWY_EXPORT(GatherBlocks);

Gathered GatherBlocks(const LitPlanes& planes, int x0, int x1, int y0, int y1, const GatherTarget& target) {
  return HWY_DYNAMIC_DISPATCH(GatherBlocks)(planes, x0, x1, y0, y1, target);
}

}  // namespace stratalux::fit
#endif
