// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/srd_centroid.h"

#include <cmath>
#include <vector>

#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

struct Sums {
  double measured = 0.0, predicted = 0.0, shift2 = 0.0, error2 = 0.0;
  int64_t profiles = 0;
};

double Centroid(const std::vector<double>& y, const SrdBatch& batch, int64_t profile, double reach_mm) {
  const double step = batch.step_mm[profile], period = step * batch.samples;
  double sum = 0.0, moment = 0.0;
  for (int k = 0; k < batch.samples; ++k) {
    const double u = std::remainder(batch.first_u_mm[profile] + k * step, period);
    if (std::abs(u) > reach_mm) continue;
    sum += y[k];
    moment += y[k] * u;
  }
  // Of light it lies among the samples; what lies elsewhere is the noise of a profile with next to none.
  return sum > 0.0 && std::abs(moment) <= reach_mm * sum ? moment / sum : std::nan("");
}

Sums OfProfile(const MixtureMap& map, const SrdBatch& heldout, int projector, int64_t profile, double reach_mm) {
  const ScatteringModel& model = map.scattering;
  const double s = ShiftCoefficient(model, heldout, profile);
  const std::vector<double> predicted =
      PredictSamples(LayersOf(map, profile), UnlayeredOf(map, profile, projector, heldout, profile), heldout, profile,
                     model, reach_mm);
  const auto y = heldout.Samples(profile);
  const double measured_at = Centroid({y.begin(), y.end()}, heldout, profile, reach_mm),
               predicted_at = Centroid(predicted, heldout, profile, reach_mm);
  if (!std::isfinite(measured_at) || !std::isfinite(predicted_at)) return {};
  return {measured_at * s, predicted_at * s, s * s, std::pow(predicted_at - measured_at, 2), 1};
}

}  // namespace

CentroidError CompareCentroids(const MixtureMap& map, const SrdBatch& heldout, int projector, double reach_mm,
                               int every) {
  std::vector<int64_t> chosen;
  for (int64_t i = 0; i < map.profiles(); ++i)
    if (i / map.channels % every == 0 && map.Fitted(i) && heldout.valid[i] != 0) chosen.push_back(i);
  std::vector<Sums> each(chosen.size());  // summed in order afterwards: the same bits for any number of threads
  ParallelFor(static_cast<int64_t>(chosen.size()), 64, [&](int64_t begin, int64_t end) {
    for (int64_t k = begin; k < end; ++k) each[k] = OfProfile(map, heldout, projector, chosen[k], reach_mm);
  });
  Sums all;
  for (const Sums& s : each) {
    all.measured += s.measured;
    all.predicted += s.predicted;
    all.shift2 += s.shift2;
    all.error2 += s.error2;
    all.profiles += s.profiles;
  }
  CentroidError error;
  error.profiles = all.profiles;
  if (all.profiles == 0 || !(all.shift2 > 0.0)) return error;
  error.measured_mm = all.measured / all.shift2;
  error.predicted_mm = all.predicted / all.shift2;
  error.rms_mm = std::sqrt(all.error2 / static_cast<double>(all.profiles));
  return error;
}

}  // namespace stratalux::fit
