// SPDX-License-Identifier: Apache-2.0
// Training lights left out in turn: how well do fits of the others predict them? What a session chooses by.
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/layer_set.h"
#include "fitter/mixture/srd_samples.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Of one profile of a light left out, both in photons; read noise has none.
struct LeftOutScore {
  double divergence = 0.0, photons = 0.0;
};

// 0 and 0 where nothing is known (NaN, as DivergencesFrom has it).
[[nodiscard]] LeftOutScore ScoreOf(double divergence, const SrdBatch& light, int64_t profile);

// Of one trial, profile by profile.
using LeftOutScores = std::vector<LeftOutScore>;

[[nodiscard]] double DivergenceOf(const LeftOutScores& scores);
[[nodiscard]] double PhotonsOf(const LeftOutScores& scores);
// Profiles that were judged.
[[nodiscard]] int64_t CountOf(const LeftOutScores& scores);

// Whether a trial is worse than another of the same profiles by more than so many standard errors of the difference.
[[nodiscard]] bool IsWorse(const LeftOutScores& trial, const LeftOutScores& other, double standard_errors);

// One projector left out of sampled lights, columns and rows.
struct LeftOut {
  std::vector<size_t> training, left_out;  // places among the lights
  std::vector<int> names;                  // of the training ones
  std::vector<LayerSet> mean;              // their mean layers, by channel
};

// Some 500 pixels of all lights, evenly spread (enough to tell one choice from another; more cost time), and each
// projector left out of them: made once for all that a fit chooses.
struct LeftOutLights {
  std::vector<int> projectors;  // of the lights
  int channels = 0;
  std::vector<SrdBatch> sampled;  // [light]
  std::vector<LeftOut> turns;     // none where there are fewer than two projectors
};

[[nodiscard]] Result<LeftOutLights> LeaveOutEach(std::span<const SrdBatch* const> lights,
                                                 const std::vector<int>& projectors, int channels,
                                                 const EmOptions& options);

[[nodiscard]] std::vector<const SrdBatch*> PointersTo(const std::vector<SrdBatch>& batches);
[[nodiscard]] std::vector<const SrdBatch*> At(std::span<const SrdBatch* const> lights, std::span<const size_t> places);

}  // namespace stratalux::fit
