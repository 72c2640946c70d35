// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_projection.h"

#include <algorithm>
#include <cstddef>
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

// `count` rows before the first and behind the last of `rows`: periodic ones, or none.
void Extend(float* first, int rows, int count, bool periodic) {
  const size_t bytes = sizeof(float) * kEmLanes * static_cast<size_t>(count);
  if (!periodic) {
    std::memset(first - size_t(count) * kEmLanes, 0, bytes);
    std::memset(first + size_t(rows) * kEmLanes, 0, bytes);
    return;
  }
  std::memcpy(first - size_t(count) * kEmLanes, first + size_t(rows - count) * kEmLanes, bytes);
  std::memcpy(first + size_t(rows) * kEmLanes, first, bytes);
}

// Rows that are summed into together: their sums, and what they share, stay in registers.
constexpr int kTogether = HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_NEON ? 8 : 4;  // of 32 registers, of 16

// sum[n] += in[n + i] response[i] over `taps` i, rows of `in` and of `response` each so far apart: kTaps at a time,
// whose rows of `in` are loaded once.
template <int kSums, int kTaps>
HWY_INLINE void Correlate(const float* HWY_RESTRICT in, ptrdiff_t in_step, const float* HWY_RESTRICT response,
                          ptrdiff_t response_step, int taps, V* sum) {
  const D d;
  int i = 0;
  for (; i + kTaps <= taps; i += kTaps, in += kTaps * in_step, response += kTaps * response_step) {
    V row[kSums + kTaps - 1];
    for (int n = 0; n < kSums + kTaps - 1; ++n) row[n] = hn::Load(d, in + n * in_step);
    for (int t = 0; t < kTaps; ++t) {
      const V r = hn::Load(d, response + t * response_step);
      for (int n = 0; n < kSums; ++n) sum[n] = hn::MulAdd(row[n + t], r, sum[n]);
    }
  }
  if constexpr (kTaps > 1) Correlate<kSums, kTaps / 2>(in, in_step, response, response_step, taps - i, sum);
}

// The cells j + i cps of a sample are those of sample 0, i samples on: of each j, samples and cells are a correlation.
struct Taps {
  int first = 0, count = 0;  // i
};
// One division for all of them, which would cost as much as half of the sums.
class Phases {
 public:
  explicit Phases(const EmLight& light)
      : cps_(light.cells_per_sample), whole_(light.reach / cps_), rest_(light.reach % cps_) {}
  [[nodiscard]] Taps At(int j) const {
    const int first = -whole_ - (rest_ + j >= cps_ ? 1 : 0), last = whole_ + (j < rest_ ? 1 : 0);
    return {first, last - first + 1};
  }

 private:
  int cps_, whole_, rest_;
};

template <int kSamples>
HWY_INLINE void ProjectSamples(const EmLight& light, const Phases& phases, const float* HWY_RESTRICT mass, int lane,
                               const float* surface, const float* background, int k, float* HWY_RESTRICT model) {
  const D d;
  const int cps = light.cells_per_sample;
  const ptrdiff_t stride = ptrdiff_t{cps} * kEmLanes;
  V sum[kSamples];
  for (int n = 0; n < kSamples; ++n)
    sum[n] = hn::MulAdd(hn::Load(d, surface + lane),
                        hn::Load(d, light.surface_response.data() + size_t(k + n) * kEmLanes + lane),
                        hn::Load(d, background + lane));
  for (int j = 0; j < cps; ++j) {
    const Taps taps = phases.At(j);
    Correlate<kSamples, 4>(mass + ptrdiff_t{light.pad_cells + (k + taps.first) * cps + j} * kEmLanes + lane, stride,
                           light.Response() + ptrdiff_t{taps.first * cps + j} * kEmLanes + lane, stride, taps.count,
                           sum);
  }
  for (int n = 0; n < kSamples; ++n) hn::Store(sum[n], d, model + size_t(k + n) * kEmLanes + lane);
}

void Project(EmLight& light, EmWork& work, const float* surface, const float* background) {
  const int n = static_cast<int>(hn::Lanes(D()));
  const Phases phases(light);
  float* mass = work.Mass(light);
  Extend(mass, light.grid.cells, light.reach, light.grid.wrapped);
  for (int lane = 0; lane < kEmLanes; lane += n) {
    int k = 0;
    for (; k + kTogether <= light.samples; k += kTogether)
      ProjectSamples<kTogether>(light, phases, mass, lane, surface, background, k, light.model.data());
    for (; k < light.samples; ++k)
      ProjectSamples<1>(light, phases, mass, lane, surface, background, k, light.model.data());
  }
}

void Compare(EmLight& light, EmWork& work, float* HWY_RESTRICT divergence) {
  const D d;
  const int n = static_cast<int>(hn::Lanes(d));
  const V one = hn::Set(d, 1.0F);
  float* HWY_RESTRICT ratios = work.Ratio(light);
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
      hn::Store(ratio, d, ratios + at);
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

// The j-th cells of samples k .. k + kSamples: such a cell is number j + i cps from the first one of sample k - i.
template <int kSamples>
HWY_INLINE void ProjectBackTo(const EmLight& light, const Taps& taps, const float* HWY_RESTRICT ratio, int lane, int j,
                              int k, float* HWY_RESTRICT q) {
  const D d;
  const int cps = light.cells_per_sample;
  const int last = taps.first + taps.count - 1;
  const ptrdiff_t cell = ptrdiff_t{light.pad_cells + k * cps + j} * kEmLanes + lane, stride = ptrdiff_t{cps} * kEmLanes;
  V sum[kSamples];
  for (int n = 0; n < kSamples; ++n)
    sum[n] = light.sees_all ? hn::Zero(d) : hn::Load(d, light.unseen.data() + cell + n * stride);
  Correlate<kSamples, 4>(ratio + ptrdiff_t{k - last} * kEmLanes + lane, kEmLanes,
                         light.Response() + ptrdiff_t{j + last * cps} * kEmLanes + lane, -stride, taps.count, sum);
  for (int n = 0; n < kSamples; ++n) hn::Store(sum[n], d, q + cell + n * stride);
}

void ProjectBack(const EmLight& light, EmWork& work) {
  const int cps = light.cells_per_sample;
  const Phases phases(light);
  float* ratio = work.Ratio(light);
  const bool wrapped = light.grid.wrapped;
  Extend(ratio, light.samples, wrapped ? std::min(light.reach / cps + 1, light.samples) : light.halo_samples, wrapped);
  for (int lane = 0; lane < kEmLanes; lane += static_cast<int>(hn::Lanes(D())))
    for (int j = 0; j < cps; ++j) {
      const Taps taps = phases.At(j);
      int k = -((light.pad_cells + j) / cps);
      const int behind = (light.grid.cells - 1 - light.pad_cells - j) / cps + 1;
      for (; k + kTogether <= behind; k += kTogether)
        ProjectBackTo<kTogether>(light, taps, ratio, lane, j, k, work.q.data());
      for (; k < behind; ++k) ProjectBackTo<1>(light, taps, ratio, lane, j, k, work.q.data());
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

void Project(EmLight& light, EmWork& work, const float* surface, const float* background) {
  HWY_DYNAMIC_DISPATCH(Project)(light, work, surface, background);
}
void Compare(EmLight& light, EmWork& work, float* divergence) {
  HWY_DYNAMIC_DISPATCH(Compare)(light, work, divergence);
}
void ProjectBack(const EmLight& light, EmWork& work) { HWY_DYNAMIC_DISPATCH(ProjectBack)(light, work); }

}  // namespace stratalux::fit
#endif
