// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_prior.h"

#include <algorithm>
#include <utility>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitter/mixture/em_prior.cc"
#include "fitter/mixture/highway_targets.h"
// After the targets:
#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace stratalux::fit {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, kEmLanes>;
using V = hn::Vec<D>;

HWY_INLINE void AddTo(V value, float* at) {
  const D d;
  hn::Store(hn::Add(hn::Load(d, at), value), d, at);
}

// Of the known pixel's layers, about the old means.
void AddPriorMoments(const ParameterRows& rows, float square_shift, const float* HWY_RESTRICT centre,
                     const float* HWY_RESTRICT photons, const float* HWY_RESTRICT at, MomentSums& sums) {
  const D d;
  const V square = hn::Set(d, square_shift);
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d)))
    for (int l = 0; l < rows.layers; ++l) {
      const size_t row = size_t(l) * kEmLanes + lane, depth = size_t(rows.depth(l)) * kEmLanes + lane;
      const V n = hn::Load(d, photons + size_t(rows.weight(l)) * kEmLanes + lane);
      const V sigma = hn::Load(d, centre + size_t(rows.sigma(l)) * kEmLanes + lane);
      const V away = hn::Sub(hn::Load(d, centre + depth), hn::Load(d, at + depth));
      const V leverage = hn::Mul(n, square);
      AddTo(n, sums.photons.data() + row);
      AddTo(leverage, sums.leverage.data() + row);
      AddTo(hn::Mul(leverage, away), sums.moved.data() + row);
      AddTo(hn::MulAdd(hn::Mul(leverage, away), away, hn::Mul(n, hn::Mul(sigma, sigma))), sums.spread.data() + row);
    }
}

// r - 1 - log r of r = 1 + e: no cancellation near r = 1.
HWY_INLINE V Apart(V e) {
  const D d;
  return hn::Sub(e, hn::Log1p(d, hn::Max(e, hn::Set(d, -0.9999999F))));
}

// Of layer l, over its photons: widths, and depths under shifts of mean square `square`.
HWY_INLINE V ShapeApart(const ParameterRows& rows, int l, int lane, V square, const float* HWY_RESTRICT centre,
                        const float* HWY_RESTRICT at) {
  const D d;
  const size_t depth = size_t(rows.depth(l)) * kEmLanes + lane, width = size_t(rows.sigma(l)) * kEmLanes + lane;
  const V sigma = hn::Load(d, at + width), known = hn::Load(d, centre + width);
  const V away = hn::Sub(hn::Load(d, at + depth), hn::Load(d, centre + depth));
  const V per_variance = hn::Div(hn::Set(d, 1.0F), hn::Mul(sigma, sigma));
  const V narrower = hn::Mul(hn::Mul(hn::Sub(known, sigma), hn::Add(known, sigma)), per_variance);
  return hn::Mul(hn::Set(d, 0.5F), hn::MulAdd(hn::Mul(square, hn::Mul(away, away)), per_variance, Apart(narrower)));
}

void AddPriorCost(const ParameterRows& rows, float square_shift, const float* HWY_RESTRICT centre,
                  const float* HWY_RESTRICT photons, const float* HWY_RESTRICT total, const float* HWY_RESTRICT shown,
                  const float* HWY_RESTRICT at, float* HWY_RESTRICT cost) {
  const D d;
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0F), square = hn::Set(d, square_shift);
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(d))) {
    V all = zero, sum = zero;
    for (int row = 0; row < rows.size(); ++row) all = hn::Add(all, hn::Load(d, shown + size_t(row) * kEmLanes + lane));
    const V scale = hn::Div(hn::Load(d, total + lane), hn::IfThenElse(hn::Gt(all, zero), all, one));
    for (int row = 0; row < rows.size(); ++row) {
      const V n = hn::Load(d, photons + size_t(row) * kEmLanes + lane);
      const auto held = hn::And(hn::Gt(all, zero), hn::Gt(n, zero));
      const V expected = hn::Mul(hn::Load(d, shown + size_t(row) * kEmLanes + lane), scale);  // N0 q
      V apart = Apart(hn::Div(hn::Sub(expected, n), hn::IfThenElse(held, n, one)));
      if (row < rows.layers) apart = hn::Add(apart, ShapeApart(rows, row, lane, square, centre, at));
      sum = hn::IfThenElse(held, hn::MulAdd(n, apart, sum), sum);
    }
    AddTo(sum, cost + lane);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace stratalux::fit
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stratalux::fit {

HWY_EXPORT(AddPriorMoments);
HWY_EXPORT(AddPriorCost);

EmPrior::EmPrior(const ParameterRows& rows, double square_shift, bool surface_held)
    : rows_(rows), square_shift_(static_cast<float>(square_shift)), surface_held_(surface_held) {
  for (auto* v : {&centre_, &photons_, &shown_}) v->assign(RowOf(rows.size()), 0.0F);
}

void EmPrior::Clear(int lane) {
  total_[lane] = 0.0F;
  fresh_[lane] = 0.0;
  for (size_t i = lane; i < photons_.size(); i += kEmLanes) photons_[i] = 0.0F;
}

void EmPrior::Set(int lane, double photons, const float* at) {
  for (size_t i = lane; i < centre_.size(); i += kEmLanes) centre_[i] = at[i];
  fresh_[lane] = photons;
}

void EmPrior::BeginSweep() { std::fill(shown_.begin(), shown_.end(), 0.0F); }

void EmPrior::AddShown(int p, const EmLight& light, const float* at, const float* weight) {
  for (int l = 0; l < rows_.layers; ++l)
    for (int i = 0; i < kEmLanes; ++i)
      shown_[RowOf(rows_.weight(l)) + i] += light.counts[i] * light.coverage[i] * weight[RowOf(l) + i];
  const size_t surface = RowOf(rows_.surface(p)), background = RowOf(rows_.background(p));
  for (int i = 0; i < kEmLanes; ++i) {
    if (!surface_held_) shown_[surface + i] = light.counts[i] * light.surface_total[i] * at[surface + i];
    shown_[background + i] = light.counts[i] * static_cast<float>(light.samples) * at[background + i];
  }
}

// N0 photons, as the lights show those of the known pixel.
void EmPrior::ShareOut(int lane) {
  const double n0 = std::exchange(fresh_[lane], 0.0);
  double all = 0.0;
  for (int row = 0; row < rows_.size(); ++row) all += shown_[RowOf(row) + lane];
  if (!(all > 0.0)) return;
  total_[lane] = static_cast<float>(n0);
  for (int row = 0; row < rows_.size(); ++row)
    photons_[RowOf(row) + lane] = static_cast<float>(n0 / all * shown_[RowOf(row) + lane]);
}

void EmPrior::ShareOut() {
  for (int lane = 0; lane < kEmLanes; ++lane)
    if (fresh_[lane] > 0.0) ShareOut(lane);
}

void EmPrior::AddCost(const float* at, float* cost) {
  ShareOut();
  HWY_DYNAMIC_DISPATCH(AddPriorCost)
  (rows_, square_shift_, centre_.data(), photons_.data(), total_.data(), shown_.data(), at, cost);
}

void EmPrior::AddPhotons(std::span<const EmLight> lights, const float* at, MomentSums& sums, float* image) const {
  HWY_DYNAMIC_DISPATCH(AddPriorMoments)(rows_, square_shift_, centre_.data(), photons_.data(), at, sums);
  for (int p = 0; p < rows_.lights; ++p)
    for (int i = 0; i < kEmLanes; ++i) {
      const EmLight& light = lights[p];
      if (!(light.counts[i] > 0.0F)) continue;
      const size_t surface = RowOf(rows_.surface(p)) + i, background = RowOf(rows_.background(p)) + i;
      if (light.surface_total[i] > 0.0F)
        image[surface] += photons_[surface] / (light.counts[i] * light.surface_total[i]);
      image[background] += photons_[background] / (light.counts[i] * static_cast<float>(light.samples));
    }
}

void EmPrior::KeepTotal(std::span<const EmLight> lights, const MomentSums& sums, float* image) const {
  for (int i = 0; i < kEmLanes; ++i) {
    if (!(total_[i] > 0.0F)) continue;
    double all = 0.0;
    for (int l = 0; l < rows_.layers; ++l) all += sums.photons[RowOf(l) + i];
    for (int p = 0; p < rows_.lights; ++p) {
      const EmLight& light = lights[p];
      if (!surface_held_)
        all += double(light.counts[i]) * double(light.surface_total[i]) * image[RowOf(rows_.surface(p)) + i];
      all += double(light.counts[i]) * double(light.samples) * image[RowOf(rows_.background(p)) + i];
    }
    const float own = static_cast<float>(std::max(1.0 - total_[i] / all, 0.0));
    for (int l = 0; l < rows_.layers; ++l) image[RowOf(rows_.weight(l)) + i] *= own;
    for (int p = 0; p < rows_.lights; ++p) {
      if (!surface_held_) image[RowOf(rows_.surface(p)) + i] *= own;
      image[RowOf(rows_.background(p)) + i] *= own;
    }
  }
}

}  // namespace stratalux::fit
#endif
