// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_projection.h"

#include <algorithm>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitter/mixture/em_projection.cc"
#include "fitter/mixture/highway_targets.h"
// After the targets:
#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace stratalux::fit {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, kEmLanes>;
using V = hn::Vec<D>;

constexpr float kTiny = 1e-12F;

// `count` periodic rows before the first and behind the last of `rows`.
void CopyRound(float* first, int rows, int count) {
  const size_t bytes = sizeof(float) * kEmLanes * static_cast<size_t>(count);
  std::memcpy(first - size_t(count) * kEmLanes, first + size_t(rows - count) * kEmLanes, bytes);
  std::memcpy(first + size_t(rows) * kEmLanes, first, bytes);
}

// Samples k .. k + kSamples share each load of the response.
template <int kSamples>
HWY_INLINE void ProjectSamples(const EmLight& light, const float* HWY_RESTRICT mass, int lane, const float* surface,
                               const float* background, int k, float* HWY_RESTRICT model) {
  const D d;
  V sum[kSamples];
  for (int i = 0; i < kSamples; ++i)
    sum[i] = hn::MulAdd(hn::Load(d, surface + lane),
                        hn::Load(d, light.surface_response.data() + size_t(k + i) * kEmLanes + lane),
                        hn::Load(d, background + lane));
  const float* response = light.Response() - size_t(light.reach) * kEmLanes + lane;
  const float* at = mass + (light.pad_cells + k * light.cells_per_sample - light.reach) * kEmLanes + lane;
  const int stride = light.cells_per_sample * kEmLanes;
  for (int t = -light.reach; t < light.cells_per_sample + light.reach; ++t, response += kEmLanes, at += kEmLanes) {
    const V r = hn::Load(d, response);
    for (int i = 0; i < kSamples; ++i) sum[i] = hn::MulAdd(hn::Load(d, at + i * stride), r, sum[i]);
  }
  for (int i = 0; i < kSamples; ++i) hn::Store(sum[i], d, model + size_t(k + i) * kEmLanes + lane);
}

void Project(EmLight& light, const float* surface, const float* background) {
  const int n = static_cast<int>(hn::Lanes(D()));
  if (light.grid.wrapped) CopyRound(light.Mass(), light.grid.cells, light.reach);
  for (int lane = 0; lane < kEmLanes; lane += n) {
    int k = 0;
    for (; k + 4 <= light.samples; k += 4)
      ProjectSamples<4>(light, light.Mass(), lane, surface, background, k, light.model.data());
    for (; k < light.samples; ++k)
      ProjectSamples<1>(light, light.Mass(), lane, surface, background, k, light.model.data());
  }
}

void Compare(EmLight& light, float* HWY_RESTRICT divergence) {
  const D d;
  const int n = static_cast<int>(hn::Lanes(d));
  const V one = hn::Set(d, 1.0F);
  for (int lane = 0; lane < kEmLanes; lane += n) {
    const V shift = hn::Load(d, light.shift.data() + lane), counts = hn::Load(d, light.counts.data() + lane);
    const auto present = hn::Gt(counts, hn::Zero(d));
    V apart = hn::Zero(d), sum = hn::Zero(d), own = hn::Zero(d);
    for (int k = 0; k < light.samples; ++k) {
      const size_t at = size_t(k) * kEmLanes + lane;
      const V data = hn::Load(d, light.data.data() + at);
      const V model = hn::Max(hn::Add(hn::Load(d, light.model.data() + at), shift), hn::Set(d, kTiny));
      const V inverse = hn::Div(one, model);
      const V ratio = hn::IfThenElseZero(present, hn::Mul(data, inverse));
      hn::Store(ratio, d, light.Ratio() + at);
      sum = hn::Add(sum, ratio);
      own = hn::MulAdd(ratio, hn::Load(d, light.surface_response.data() + at), own);
      // m - d + d log(d / m) = m ((1 + e) log(1 + e) - e) with d = m (1 + e): no cancellation near agreement.
      const V e = hn::Mul(hn::Sub(data, model), inverse);
      const V log = hn::Log1p(d, hn::Max(e, hn::Set(d, -0.9999999F)));
      apart = hn::MulAdd(model, hn::Sub(hn::Mul(ratio, log), e), apart);
    }
    hn::Store(sum, d, light.ratio_sum.data() + lane);
    hn::Store(own, d, light.surface_ratio.data() + lane);
    const V share = hn::IfThenElseZero(present, hn::Mul(counts, apart));
    hn::Store(hn::Add(hn::Load(d, divergence + lane), share), d, divergence + lane);
  }
}

// The j-th cells of samples k .. k + kSamples share each load of the response: such a cell is number j + i cps from the
// first one of sample k - i.
template <int kSamples>
HWY_INLINE void ProjectBackTo(const EmLight& light, const float* HWY_RESTRICT ratio, int lane, int j, int k,
                              float* HWY_RESTRICT q) {
  const D d;
  const int cps = light.cells_per_sample;
  const int first = -((light.reach + j) / cps), last = (cps + light.reach - 1 - j) / cps;
  const size_t cell = static_cast<size_t>(light.pad_cells + k * cps + j) * kEmLanes + lane;
  const size_t stride = static_cast<size_t>(cps) * kEmLanes;
  V sum[kSamples];
  for (int n = 0; n < kSamples; ++n) sum[n] = hn::Load(d, light.unseen.data() + cell + n * stride);
  const float* from = ratio + (k - first) * kEmLanes + lane;
  const float* response = light.Response() + (j + first * cps) * kEmLanes + lane;
  for (int i = first; i <= last; ++i, from -= kEmLanes, response += stride) {
    const V r = hn::Load(d, response);
    for (int n = 0; n < kSamples; ++n) sum[n] = hn::MulAdd(hn::Load(d, from + n * kEmLanes), r, sum[n]);
  }
  for (int n = 0; n < kSamples; ++n) hn::Store(sum[n], d, q + cell + n * stride);
}

void ProjectBack(EmLight& light) {
  const int cps = light.cells_per_sample;
  if (light.grid.wrapped) CopyRound(light.Ratio(), light.samples, std::min(light.reach / cps + 1, light.samples));
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(D())))
    for (int j = 0; j < cps; ++j) {
      int k = -((light.pad_cells + j) / cps);
      const int behind = (light.grid.cells - 1 - light.pad_cells - j) / cps + 1;
      for (; k + 4 <= behind; k += 4) ProjectBackTo<4>(light, light.Ratio(), lane, j, k, light.q.data());
      for (; k < behind; ++k) ProjectBackTo<1>(light, light.Ratio(), lane, j, k, light.q.data());
    }
}

}  // namespace HWY_NAMESPACE
}  // namespace stratalux::fit
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stratalux::fit {

HWY_EXPORT(Project);
HWY_EXPORT(Compare);
HWY_EXPORT(ProjectBack);

void Project(EmLight& light, const float* surface, const float* background) {
  HWY_DYNAMIC_DISPATCH(Project)(light, surface, background);
}
void Compare(EmLight& light, float* divergence) { HWY_DYNAMIC_DISPATCH(Compare)(light, divergence); }
void ProjectBack(EmLight& light) { HWY_DYNAMIC_DISPATCH(ProjectBack)(light); }

}  // namespace stratalux::fit
#endif
