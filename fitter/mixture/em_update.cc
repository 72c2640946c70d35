// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_update.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitter/mixture/em_update.cc"
#include "fitter/mixture/highway_targets.h"
// After the targets:
#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace stratalux::fit {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, kEmLanes>;
using V = hn::Vec<D>;

void DirectionalFactors(const ParameterRows& rows, const DirectionalWeights& weights, const float* HWY_RESTRICT at,
                        const EmLight& light, float* HWY_RESTRICT factor) {
  const D d;
  const V per_sigma = hn::Set(d, weights.sigma_0_mm > 0.0 ? static_cast<float>(-1.0 / weights.sigma_0_mm) : -1e6F);
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d))) {
    const V loss =
        hn::Mul(hn::Load(d, light.extra_path.data() + lane), hn::Set(d, static_cast<float>(-weights.kappa_per_mm)));
    const V phase_m1 = hn::Load(d, light.phase_m1.data() + lane);
    for (int l = 0; l < rows.layers; ++l) {
      const V depth = hn::Load(d, at + size_t(rows.depth(l)) * kEmLanes + lane);
      const V narrow = hn::Exp(d, hn::Mul(hn::Load(d, at + size_t(rows.sigma(l)) * kEmLanes + lane), per_sigma));
      const V path = hn::Exp(d, hn::Mul(depth, loss));
      hn::Store(hn::MulAdd(hn::Mul(path, narrow), phase_m1, path), d, factor + size_t(l) * kEmLanes + lane);
    }
  }
}

void PlaceLayers(const ParameterRows& rows, const float* HWY_RESTRICT at, const EmLight& light,
                 const float* HWY_RESTRICT factor, float* HWY_RESTRICT weight, float* HWY_RESTRICT mean,
                 float* HWY_RESTRICT sigma) {
  const D d;
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d))) {
    const V per_cell = hn::Div(hn::Set(d, 1.0F), hn::Load(d, light.cell_mm.data() + lane));
    const V gain = hn::IfThenElseZero(hn::Gt(hn::Load(d, light.counts.data() + lane), hn::Zero(d)),
                                      hn::Load(d, light.gain.data() + lane));
    const V shift = hn::Mul(hn::Load(d, light.s.data() + lane), per_cell);
    for (int l = 0; l < rows.layers; ++l) {
      const size_t row = size_t(l) * kEmLanes + lane;
      V w = hn::Mul(hn::Load(d, at + size_t(rows.weight(l)) * kEmLanes + lane), gain);
      if (factor != nullptr) w = hn::Mul(w, hn::Load(d, factor + row));
      hn::Store(w, d, weight + row);
      hn::Store(hn::MulAdd(hn::Load(d, at + size_t(rows.depth(l)) * kEmLanes + lane), shift,
                           hn::Load(d, light.origin.data() + lane)),
                d, mean + row);
      hn::Store(hn::Max(hn::Mul(hn::Load(d, at + size_t(rows.sigma(l)) * kEmLanes + lane), per_cell),
                        hn::Set(d, kLeastSigmaCells)),
                d, sigma + row);
    }
  }
}

HWY_INLINE void AddTo(V value, float* at) {
  const D d;
  hn::Store(hn::Add(hn::Load(d, at), value), d, at);
}

void AddMoments(int layers, const EmLight& light, const float* HWY_RESTRICT moments, MomentSums& sums) {
  const D d;
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d))) {
    const V n = hn::Load(d, light.counts.data() + lane), s = hn::Load(d, light.s.data() + lane);
    const V cell = hn::Load(d, light.cell_mm.data() + lane);
    for (int l = 0; l < layers; ++l) {
      const size_t row = size_t(l) * kEmLanes + lane;
      const float* moment = moments + size_t(l) * 3 * kEmLanes + lane;
      const V c = hn::Mul(n, hn::Load(d, moment));
      const V cz = hn::Mul(hn::Mul(n, s), hn::Mul(hn::Load(d, moment + kEmLanes), cell));
      const V czz = hn::Mul(n, hn::Mul(hn::Load(d, moment + 2 * kEmLanes), hn::Mul(cell, cell)));
      AddTo(c, sums.photons.data() + row);
      AddTo(cz, sums.moved.data() + row);
      AddTo(hn::Mul(hn::Mul(s, s), c), sums.leverage.data() + row);
      AddTo(czz, sums.spread.data() + row);
    }
  }
}

void AddExposure(int layers, const EmLight& light, const float* HWY_RESTRICT factor, MomentSums& sums) {
  const D d;
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d))) {
    const V exposure =
        hn::Mul(hn::Load(d, light.counts.data() + lane),
                hn::Mul(hn::Load(d, light.gain.data() + lane), hn::Load(d, light.full_coverage.data() + lane)));
    for (int l = 0; l < layers; ++l) {
      const size_t row = size_t(l) * kEmLanes + lane;
      AddTo(factor != nullptr ? hn::Mul(exposure, hn::Load(d, factor + row)) : exposure, sums.exposure.data() + row);
    }
  }
}

// A layer that lost its light keeps its place without weight.
constexpr float kLeastWeight = 1e-9F;

void UpdateShapes(const ParameterRows& rows, const LayerBounds& bounds, const MomentSums& sums,
                  const float* HWY_RESTRICT at, float* HWY_RESTRICT image) {
  const D d;
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0F);
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d)))
    for (int l = 0; l < rows.layers; ++l) {
      const size_t row = size_t(l) * kEmLanes + lane;
      const size_t depth = size_t(rows.depth(l)) * kEmLanes + lane, sigma = size_t(rows.sigma(l)) * kEmLanes + lane;
      const V photons = hn::Load(d, sums.photons.data() + row), moved = hn::Load(d, sums.moved.data() + row);
      const V leverage = hn::Load(d, sums.leverage.data() + row), old_depth = hn::Load(d, at + depth);
      const auto lit = hn::Gt(photons, zero);
      V step = zero;
      if (!bounds.fixed_depth) {
        const auto tells = hn::Gt(leverage, hn::Mul(photons, hn::Set(d, 1e-6F)));
        const V wanted = hn::Add(old_depth, hn::Div(moved, hn::IfThenElse(tells, leverage, one)));
        const V allowed = hn::Min(hn::Max(wanted, hn::Set(d, bounds.least_depth_mm)), hn::Set(d, bounds.most_depth_mm));
        step = hn::IfThenElseZero(tells, hn::Sub(allowed, old_depth));
      }
      hn::Store(hn::Add(old_depth, step), d, image + depth);
      // Around the new means.
      const V about = hn::MulAdd(hn::Mul(step, step), leverage,
                                 hn::NegMulAdd(hn::Add(step, step), moved, hn::Load(d, sums.spread.data() + row)));
      const V variance = hn::Max(hn::Div(about, hn::IfThenElse(lit, photons, one)), zero);
      const V width = hn::Min(hn::Max(hn::Sqrt(variance), hn::Load(d, bounds.least_sigma_mm.data() + lane)),
                              hn::Load(d, bounds.most_sigma_mm.data() + lane));
      hn::Store(hn::IfThenElse(lit, width, hn::Load(d, at + sigma)), d, image + sigma);
    }
}

void UpdateWeights(const ParameterRows& rows, const MomentSums& sums, float* HWY_RESTRICT image) {
  const D d;
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d)))
    for (int l = 0; l < rows.layers; ++l) {
      const size_t row = size_t(l) * kEmLanes + lane;
      const V photons = hn::Load(d, sums.photons.data() + row), exposure = hn::Load(d, sums.exposure.data() + row);
      const auto lit =
          hn::And(hn::Gt(exposure, hn::Zero(d)), hn::Gt(photons, hn::Mul(exposure, hn::Set(d, kLeastWeight))));
      const V weight = hn::Div(photons, hn::IfThenElse(lit, exposure, hn::Set(d, 1.0F)));
      hn::Store(hn::IfThenElseZero(lit, weight), d, image + size_t(rows.weight(l)) * kEmLanes + lane);
    }
}

// image (image / last)^momentum, at most a factor e away; zeros stay.
HWY_INLINE V Onward(V image, V last, V momentum) {
  const D d;
  const V one = hn::Set(d, 1.0F);
  const auto positive = hn::And(hn::Gt(image, hn::Zero(d)), hn::Gt(last, hn::Zero(d)));
  const V growth = hn::Div(hn::IfThenElse(positive, image, one), hn::IfThenElse(positive, last, one));
  const V step = hn::Min(hn::Max(hn::Mul(momentum, hn::Log(d, growth)), hn::Set(d, -1.0F)), one);
  return hn::Mul(image, hn::Exp(d, step));
}

void Advance(const ParameterRows& rows, const LayerBounds& bounds, const int* HWY_RESTRICT step,
             const float* HWY_RESTRICT momentum, const float* HWY_RESTRICT image, float* HWY_RESTRICT last,
             float* HWY_RESTRICT at) {
  const D d;
  const hn::RebindToSigned<D> di;
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d))) {
    const auto steps = hn::Load(di, step + lane);
    const auto on = hn::RebindMask(d, hn::Eq(steps, hn::Set(di, int{kAdvance})));
    const auto back = hn::RebindMask(d, hn::Eq(steps, hn::Set(di, int{kReturn})));
    const V beta = hn::Load(d, momentum + lane);
    const bool moves = !hn::AllTrue(d, hn::Eq(beta, hn::Zero(d)));
    for (int row = 0; row < rows.size(); ++row) {
      const size_t i = size_t(row) * kEmLanes + lane;
      const V to = hn::Load(d, image + i), from = hn::Load(d, last + i);
      V next = to;
      if (moves && row >= rows.depth(0) && row < rows.sigma(0)) {
        next = hn::MulAdd(beta, hn::Sub(to, from), to);
        next = hn::Min(hn::Max(next, hn::Set(d, bounds.least_depth_mm)), hn::Set(d, bounds.most_depth_mm));
      } else if (moves) {
        next = Onward(to, from, beta);
        if (row >= rows.sigma(0) && row < rows.surface(0))
          next = hn::Min(hn::Max(next, hn::Load(d, bounds.least_sigma_mm.data() + lane)),
                         hn::Load(d, bounds.most_sigma_mm.data() + lane));
      }
      next = hn::IfThenElse(hn::Eq(beta, hn::Zero(d)), to, next);
      next = hn::IfThenElse(on, next, hn::IfThenElse(back, from, hn::Load(d, at + i)));
      hn::Store(next, d, at + i);
      hn::Store(hn::IfThenElse(on, to, from), d, last + i);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace stratalux::fit
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stratalux::fit {

HWY_EXPORT(DirectionalFactors);
HWY_EXPORT(PlaceLayers);
HWY_EXPORT(AddMoments);
HWY_EXPORT(AddExposure);
HWY_EXPORT(UpdateShapes);
HWY_EXPORT(UpdateWeights);
HWY_EXPORT(Advance);

void DirectionalFactors(const ParameterRows& rows, const DirectionalWeights& weights, const float* at,
                        const EmLight& light, float* factor) {
  HWY_DYNAMIC_DISPATCH(DirectionalFactors)(rows, weights, at, light, factor);
}
void PlaceLayers(const ParameterRows& rows, const float* at, const EmLight& light, const float* factor, float* weight,
                 float* mean, float* sigma) {
  HWY_DYNAMIC_DISPATCH(PlaceLayers)(rows, at, light, factor, weight, mean, sigma);
}
void AddMoments(int layers, const EmLight& light, const float* moments, MomentSums& sums) {
  HWY_DYNAMIC_DISPATCH(AddMoments)(layers, light, moments, sums);
}
void AddExposure(int layers, const EmLight& light, const float* factor, MomentSums& sums) {
  HWY_DYNAMIC_DISPATCH(AddExposure)(layers, light, factor, sums);
}
void UpdateShapes(const ParameterRows& rows, const LayerBounds& bounds, const MomentSums& sums, const float* at,
                  float* image) {
  HWY_DYNAMIC_DISPATCH(UpdateShapes)(rows, bounds, sums, at, image);
}
void UpdateWeights(const ParameterRows& rows, const MomentSums& sums, float* image) {
  HWY_DYNAMIC_DISPATCH(UpdateWeights)(rows, sums, image);
}
void Advance(const ParameterRows& rows, const LayerBounds& bounds, const int* step, const float* momentum,
             const float* image, float* last, float* at) {
  HWY_DYNAMIC_DISPATCH(Advance)(rows, bounds, step, momentum, image, last, at);
}

}  // namespace stratalux::fit
#endif
