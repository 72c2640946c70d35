// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/mean_layers.h"

#include <algorithm>
#include <array>
#include <memory>
#include <utility>

#include "fitter/mixture/choose_prior.h"
#include "fitter/mixture/em_block.h"
#include "fitter/mixture/em_pace.h"
#include "fitter/mixture/em_tasks.h"
#include "shared/base/check.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

// In units of EmOptions::max_iterations. What many profiles have in common has little noise to be fitted: EM goes on
// until it settles, after 40 to 80 sweeps.
constexpr int kMostSweeps = 10;

// Profiles that are fitted together.
class Pool {
 public:
  Pool(std::span<const SrdBatch* const> lights, const Judgement& judged, int channels, const EmOptions& options,
       std::span<const LayerSet> start)
      : channels_(channels), options_(options), rows_{options.layers, 0}, common_(channels), pace_(channels) {
    SLX_CHECK(channels <= kEmLanes);
    const EmTasks tasks = TasksOf(lights, judged, channels, options, kEmLanes);
    blocks_.resize(tasks.size());
    ParallelEach(tasks.size(), [&](size_t t) {
      blocks_[t] = std::make_unique<EmBlock>(lights, judged.usable, tasks.cells_per_sample(t), options, start);
      blocks_[t]->Hold(tasks.profiles(t));
    });
    bounds_.least_depth_mm = static_cast<float>(options.min_depth_mm);
    bounds_.most_depth_mm = static_cast<float>(options.max_depth_mm);
    bounds_.fixed_depth = options.direction_blind;
    bounds_.least_sigma_mm.at.fill(static_cast<float>(options.min_sigma_mm));
    bounds_.most_sigma_mm.at.fill(static_cast<float>(std::max(options.min_sigma_mm, options.max_sigma_mm)));
    for (auto* rows : {&at_, &image_, &last_}) rows->assign(RowOf(rows_.size()), 0.0F);
    Begin(start);
  }

  std::vector<LayerSet> Fit() {
    const int most = kMostSweeps * std::max(1, options_.max_iterations);
    while (std::any_of(pace_.begin(), pace_.end(), [](const EmPace& pace) { return !pace.last; })) {
      Expect();
      UpdateShapes(rows_, bounds_, sums_, at_.data(), image_.data());
      UpdateWeights(rows_, sums_, image_.data());
      alignas(64) std::array<int, kEmLanes> step{};
      LaneRow momentum;
      for (int c = 0; c < channels_; ++c)
        if (!pace_[c].last)
          step[c] = pace_[c].Judge(relative_cost_[c], options_.tolerance, options_.accelerated, most, momentum[c]);
      Advance(rows_, bounds_, step.data(), momentum.data(), image_.data(), last_.data(), at_.data());
      TakeCommon();
    }
    AddUpBrightness();
    return common_;
  }

 private:
  // Without known layers, the mean of what each would start from, but weights fall with the square of the width: what
  // is too wide is lowered slowly where read noise is most of what a sample has.
  void Begin(std::span<const LayerSet> known) {
    std::vector<double> profiles(channels_, 0.0);
    std::vector<double> sum(RowOf(rows_.size()), 0.0);
    ForEachHeld([&](const EmBlock& block, int lane, int c) {
      profiles[c] += 1.0;
      if (IsKnown(known, c)) return;
      const LayerSet start = block.StartOf(lane);
      for (int l = 0; l < rows_.layers; ++l) {
        sum[RowOf(rows_.weight(l)) + c] += start.weight[l] / start.sigma_mm[l];
        sum[RowOf(rows_.depth(l)) + c] += start.depth_mm[l];
        sum[RowOf(rows_.sigma(l)) + c] += start.sigma_mm[l];
      }
    });
    for (int c = 0; c < channels_; ++c) {
      pace_[c].last = profiles[c] == 0.0;
      for (int row = 0; row < rows_.size(); ++row)
        at_[RowOf(row) + c] = static_cast<float>(sum[RowOf(row) + c] / std::max(1.0, profiles[c]));
      if (!IsKnown(known, c)) continue;
      for (int l = 0; l < rows_.layers; ++l) {
        at_[RowOf(rows_.weight(l)) + c] = static_cast<float>(known[c].weight[l]);
        at_[RowOf(rows_.depth(l)) + c] = static_cast<float>(known[c].depth_mm[l]);
        at_[RowOf(rows_.sigma(l)) + c] = static_cast<float>(known[c].sigma_mm[l]);
      }
    }
    TakeCommon();
  }

  [[nodiscard]] static bool IsKnown(std::span<const LayerSet> known, int c) {
    return !known.empty() && !known[c].weight.empty();
  }

  void Expect() {
    ParallelEach(blocks_.size(), [&](size_t b) {
      EmBlock& block = *blocks_[b];
      if (std::ranges::all_of(block.held(), [&](int64_t profile) { return pace_[profile % channels_].last; })) return;
      std::vector<const LayerSet*> layers;
      for (const int64_t profile : block.held()) layers.push_back(&common_[profile % channels_]);
      block.Expect(layers);
    });
    // In the blocks' order, whichever thread had them. Profiles differ, as if their prior were kUsualPriorPhotons: one
    // of few photons counts by them, one of many hardly more than another of many.
    std::array<std::vector<double>, 5> sums;
    for (auto& sum : sums) sum.assign(RowOf(rows_.layers), 0.0);
    std::vector<double> cost(channels_, 0.0), photons(channels_, 0.0);
    ForEachHeld([&](const EmBlock& block, int lane, int c) {
      if (pace_[c].last) return;
      const double own = block.OwnPhotons(lane), share = kUsualPriorPhotons / (kUsualPriorPhotons + own);
      cost[c] += share * block.Cost(lane);
      photons[c] += share * own;
      for (int l = 0; l < rows_.layers; ++l) {
        const EmBlock::LayerSums of = block.HeldSum(l, lane);
        const double terms[] = {of.photons, of.moved, of.leverage, of.spread, of.exposure};
        for (size_t s = 0; s < sums.size(); ++s) sums[s][RowOf(l) + c] += share * terms[s];
      }
    });
    LaneRows* const to[] = {&sums_.photons, &sums_.moved, &sums_.leverage, &sums_.spread, &sums_.exposure};
    for (size_t s = 0; s < sums.size(); ++s) to[s]->assign(sums[s].begin(), sums[s].end());
    relative_cost_.assign(channels_, 0.0);
    for (int c = 0; c < channels_; ++c)
      if (photons[c] > 0.0) relative_cost_[c] = cost[c] / photons[c];
  }

  void TakeCommon() {
    for (int c = 0; c < channels_; ++c) {
      LayerSet& set = common_[c];
      set = {};
      for (int l = 0; l < rows_.layers && !Absent(c); ++l) {
        set.weight.push_back(at_[RowOf(rows_.weight(l)) + c]);
        set.depth_mm.push_back(at_[RowOf(rows_.depth(l)) + c]);
        set.sigma_mm.push_back(at_[RowOf(rows_.sigma(l)) + c]);
      }
    }
  }

  [[nodiscard]] bool Absent(int c) const { return pace_[c].last && pace_[c].sweeps == 0; }

  // Weights and floor of the mean brightness, in the place of any scale.
  void AddUpBrightness() {
    std::vector<double> profiles(channels_, 0.0), brightness(channels_, 0.0);
    ForEachHeld([&](const EmBlock& block, int lane, int c) {
      profiles[c] += 1.0;
      brightness[c] += block.Brightness(lane);
      common_[c].background += block.MeanBackground(lane);
    });
    for (int c = 0; c < channels_; ++c) {
      LayerSet& set = common_[c];
      double sum = 0.0;
      for (const double w : set.weight) sum += w;
      if (!(sum > 0.0)) continue;
      for (double& w : set.weight) w *= brightness[c] / profiles[c] / sum;
      set.background /= profiles[c];
    }
  }

  template <typename Work>
  void ForEachHeld(const Work& work) const {
    for (const auto& block : blocks_)
      for (size_t lane = 0; lane < block->held().size(); ++lane)
        work(*block, static_cast<int>(lane), static_cast<int>(block->held()[lane] % channels_));
  }

  int channels_;
  const EmOptions& options_;
  ParameterRows rows_;  // a channel a lane, below too
  LayerBounds bounds_;
  std::vector<std::unique_ptr<EmBlock>> blocks_;
  LaneRows at_, image_, last_;
  MomentSums sums_;
  std::vector<LayerSet> common_;
  std::vector<EmPace> pace_;
  std::vector<double> relative_cost_;
};

}  // namespace

Result<std::vector<LayerSet>> MeanLayers(std::span<const SrdBatch* const> lights, int channels,
                                         const EmOptions& options, int64_t pixels, std::span<const LayerSet> start) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_CHECK(start.empty() || std::ssize(start) == channels);
  for (const LayerSet& of : start) SLX_CHECK(of.weight.empty() || std::ssize(of.weight) == options.layers);
  SLX_CHECK(pixels >= 1);
  if (lights.empty()) return Status::Usage("EM needs at least one light");
  SLX_RETURN_IF_ERROR(CheckLights(lights, lights[0]->profiles()));
  Judgement judged = JudgeAll(lights);
  std::erase_if(judged.work, [&](int64_t i) { return lights[0]->IsApart(i); });
  // All channels of every so many pixels.
  int64_t usable = 0, before = -1;
  for (const int64_t i : judged.work) usable += std::exchange(before, i / channels) != i / channels ? 1 : 0;
  const int64_t every = std::max<int64_t>(1, usable / pixels);
  int64_t count = -1;
  before = -1;
  std::erase_if(judged.work, [&](int64_t i) {
    if (std::exchange(before, i / channels) != i / channels) ++count;
    return count % every != 0;
  });
  return Pool(lights, judged, channels, options, start).Fit();
}

}  // namespace stratalux::fit
