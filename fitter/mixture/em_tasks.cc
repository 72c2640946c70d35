// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_tasks.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <utility>

#include "fitter/mixture/fine_grid.h"
#include "fitter/mixture/photon_noise.h"

namespace stratalux::fit {
namespace {

// Beyond, single precision would overflow somewhere in a sweep; no reflectance, no millimetre is that large.
bool Usable(float value) { return std::abs(value) < 1e9F; }

bool GeometryUsable(const SrdBatch& batch, int64_t i) {
  for (float v : {batch.first_u_mm[i], batch.line_width_mm[i], batch.blur_mm[i], batch.slope_in[i], batch.slope_out[i],
                  batch.slope_in_across[i], batch.slope_out_across[i], batch.cos_in[i]})
    if (!Usable(v)) return false;
  if (!Usable(static_cast<float>(SampleSitesOf(batch, i).ReachMm()))) return false;
  if (!batch.white.empty() && !(Usable(batch.white[i]) && Usable(batch.white_variance[i]))) return false;
  const float step = batch.step_mm[i];
  return step > 1e-6F && step < 1e6F && batch.line_width_mm[i] >= 0.0F && batch.blur_mm[i] >= 0.0F;
}

}  // namespace

FitReason JudgeProfile(const SrdBatch& batch, int64_t profile) {
  if (batch.valid[profile] == 0) return FitReason::kNoProjector;
  const auto y = batch.Samples(profile);
  double sum = 0.0;
  float low = y[0], high = y[0];
  for (int k = 0; k < batch.samples; ++k) {
    if (!Usable(y[k])) return FitReason::kNotFinite;
    sum += y[k];
    low = std::min(low, y[k]);
    high = std::max(high, y[k]);
  }
  for (const float noise : {batch.noise_floor[profile], batch.noise_slope[profile]})
    if (!Usable(noise) || !(noise >= 0.0F)) return FitReason::kNotFinite;
  const PhotonNoise photons = PhotonNoiseOf(batch, profile);
  if (!Usable(static_cast<float>(photons.counts)) || !Usable(static_cast<float>(photons.read_shift)))
    return FitReason::kNotFinite;
  if (!GeometryUsable(batch, profile)) return FitReason::kNotFinite;
  if (!(batch.cos_in[profile] > 1e-3F)) return FitReason::kNoProjector;  // from behind the horizon
  return sum > 0.0 && high > low && high > 1e-9F ? FitReason::kFitted : FitReason::kTooDark;
}

Status CheckLights(std::span<const SrdBatch* const> lights, int64_t profiles) {
  if (lights.empty()) return Status::Usage("EM needs at least one light");
  for (const SrdBatch* batch : lights) {
    if (batch->profiles() != profiles)
      return Status::Failed("EM: a light has " + std::to_string(batch->profiles()) + " profiles, expected " +
                            std::to_string(profiles));
    if (batch->samples < 3)
      return Status::Usage("EM: a profile needs at least 3 samples, not " + std::to_string(batch->samples));
  }
  return Status::Ok();
}

Judgement JudgeAll(std::span<const SrdBatch* const> lights) {
  const int64_t profiles = lights[0]->profiles();
  Judgement judged{
      std::vector(lights.size(), std::vector<uint8_t>(profiles, 0)), std::vector<uint8_t>(profiles, 0), {}};
  for (int64_t i = 0; i < profiles; ++i) {
    FitReason worst = FitReason::kNoProjector;
    bool any = false;
    for (size_t p = 0; p < lights.size(); ++p) {
      const FitReason reason = JudgeProfile(*lights[p], i);
      judged.usable[p][i] = reason == FitReason::kFitted ? 1 : 0;
      any = any || judged.usable[p][i] != 0;
      if (reason != FitReason::kNoProjector && reason != FitReason::kFitted) worst = reason;
    }
    judged.reason[i] = static_cast<uint8_t>(any ? FitReason::kFitted : worst);
    if (any) judged.work.push_back(i);
  }
  return judged;
}

EmTasks TasksOf(std::span<const SrdBatch* const> lights, const Judgement& judged, int channels,
                const EmOptions& options, size_t most) {
  EmTasks tasks;
  std::map<std::vector<int>, size_t> known;
  std::vector<std::pair<size_t, int64_t>> keys;  // grid and channel, profile
  std::vector<int> grid(lights.size());
  for (int64_t i : judged.work) {
    float blur = std::numeric_limits<float>::max();
    for (size_t p = 0; p < lights.size(); ++p)
      if (judged.usable[p][i] != 0) blur = std::min(blur, lights[p]->blur_mm[i]);
    for (size_t p = 0; p < lights.size(); ++p)
      grid[p] = judged.usable[p][i] != 0 ? CellsPerSample(*lights[p], i, blur, options) : 1;
    const auto [at, is_new] = known.emplace(grid, tasks.grids_.size());
    if (is_new) tasks.grids_.push_back(grid);
    keys.emplace_back(at->second * channels + static_cast<size_t>(i % channels), i);
  }
  std::sort(keys.begin(), keys.end());
  for (const auto& [key, i] : keys) tasks.work_.push_back(i);
  for (size_t begin = 0; begin < keys.size();) {
    const size_t of_grid = keys[begin].first / channels;
    size_t end = begin;
    while (end < keys.size() && end - begin < most && keys[end].first / channels == of_grid) ++end;
    tasks.tasks_.push_back({of_grid, begin, end});
    begin = end;
  }
  return tasks;
}

}  // namespace stratalux::fit
