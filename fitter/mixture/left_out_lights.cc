// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/left_out_lights.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/mean_layers.h"
#include "fitter/mixture/photon_noise.h"
#include "fitter/mixture/sampled_lights.h"

namespace stratalux::fit {
namespace {

constexpr int64_t kPixels = 512;

std::vector<SrdBatch> SpreadPixels(std::span<const SrdBatch* const> lights, int channels) {
  int64_t usable = 0;
  for (int64_t i = 0; i < lights[0]->profiles(); i += channels)
    usable += std::any_of(lights.begin(), lights.end(), [i](const SrdBatch* b) { return b->Shares(i); }) ? 1 : 0;
  return SampledPixels(lights, channels, static_cast<int>(std::max<int64_t>(usable / kPixels, 1)));
}

}  // namespace

LeftOutScore ScoreOf(double divergence, const SrdBatch& light, int64_t profile) {
  if (std::isnan(divergence)) return {};
  const auto y = light.Samples(profile);
  return {divergence, PhotonNoiseOf(light, profile).counts * std::accumulate(y.begin(), y.end(), 0.0)};
}

double DivergenceOf(const LeftOutScores& scores) {
  return std::accumulate(scores.begin(), scores.end(), 0.0,
                         [](double sum, const LeftOutScore& s) { return sum + s.divergence; });
}

double PhotonsOf(const LeftOutScores& scores) {
  return std::accumulate(scores.begin(), scores.end(), 0.0,
                         [](double sum, const LeftOutScore& s) { return sum + s.photons; });
}

int64_t CountOf(const LeftOutScores& scores) {
  return std::ranges::count_if(scores, [](const LeftOutScore& s) { return s.photons > 0.0; });
}

bool IsWorse(const LeftOutScores& trial, const LeftOutScores& other, double standard_errors) {
  double worse = 0.0, squares = 0.0;
  for (size_t i = 0; i < trial.size(); ++i) {
    const double more = trial[i].divergence - other[i].divergence;
    worse += more;
    squares += more * more;
  }
  return worse > standard_errors * std::sqrt(squares);
}

Result<LeftOutLights> LeaveOutEach(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                   int channels, const EmOptions& options) {
  LeftOutLights left{projectors, channels, SpreadPixels(lights, channels), {}};
  const auto sampled = PointersTo(left.sampled);
  const std::set<int> distinct(projectors.begin(), projectors.end());
  if (distinct.size() < 2) return left;
  for (const int projector : distinct) {
    LeftOut& out = left.turns.emplace_back();
    for (size_t p = 0; p < sampled.size(); ++p) {
      (projectors[p] == projector ? out.left_out : out.training).push_back(p);
      if (projectors[p] != projector) out.names.push_back(projectors[p]);
    }
    SLX_ASSIGN_OR_RETURN(out.mean, MeanLayers(At(sampled, out.training), channels, options));
  }
  return left;
}

std::vector<const SrdBatch*> PointersTo(const std::vector<SrdBatch>& batches) {
  std::vector<const SrdBatch*> pointers;
  for (const SrdBatch& b : batches) pointers.push_back(&b);
  return pointers;
}

std::vector<const SrdBatch*> At(std::span<const SrdBatch* const> lights, std::span<const size_t> places) {
  std::vector<const SrdBatch*> some;
  for (const size_t p : places) some.push_back(lights[p]);
  return some;
}

}  // namespace stratalux::fit
