// SPDX-License-Identifier: Apache-2.0
// Which profiles EM can fit, and which of them may share a block. Internal to fitter/mixture.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/mixture_map.h"
#include "fitter/mixture/srd_samples.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Lights of as many profiles each, of samples enough.
Status CheckLights(std::span<const SrdBatch* const> lights, int64_t profiles);

// Usable: samples that are finite, not constant, and add up to light.
[[nodiscard]] FitReason JudgeProfile(const SrdBatch& batch, int64_t profile);

// Every light of every profile judged once.
struct Judgement {
  std::vector<std::vector<uint8_t>> usable;  // [light][profile]
  std::vector<uint8_t> reason;               // [profile] FitReason
  std::vector<int64_t> work;                 // profiles that some light can fit
};
[[nodiscard]] Judgement JudgeAll(std::span<const SrdBatch* const> lights);

// Profiles that share the grids of their lights, cut into tasks.
class EmTasks {
 public:
  [[nodiscard]] size_t size() const { return tasks_.size(); }
  [[nodiscard]] std::span<const int64_t> profiles(size_t task) const {
    return std::span(work_).subspan(tasks_[task].begin, tasks_[task].end - tasks_[task].begin);
  }
  [[nodiscard]] std::span<const int> cells_per_sample(size_t task) const { return grids_[tasks_[task].grid]; }

 private:
  friend EmTasks TasksOf(std::span<const SrdBatch* const>, const Judgement&, int, const EmOptions&, size_t);
  struct Task {
    size_t grid = 0, begin = 0, end = 0;  // of work_
  };
  std::vector<int64_t> work_;
  std::vector<std::vector<int>> grids_;  // [grid][light] cells per sample
  std::vector<Task> tasks_;
};

// judged.work sorted by grids, then by channel (like layers meet in a block), `most` profiles a task.
[[nodiscard]] EmTasks TasksOf(std::span<const SrdBatch* const> lights, const Judgement& judged, int channels,
                              const EmOptions& options, size_t most);

}  // namespace stratalux::fit
