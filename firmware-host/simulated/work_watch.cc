// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/work_watch.h"

#include <utility>

#include "shared/base/parallel.h"

namespace stratalux::rig {
namespace {

constexpr std::chrono::milliseconds kWorthALine{500};

}  // namespace

WorkWatch::WorkWatch(Logger& logger, std::string label, const StopToken* stop)
    : logger_(logger), label_(std::move(label)), stop_(stop), start_(std::chrono::steady_clock::now()) {}

void WorkWatch::Advance(int64_t steps) {
  const std::lock_guard lock(mutex_);
  unshown_ += steps;
  if (!progress_) {
    if (std::chrono::steady_clock::now() - start_ < kWorthALine) return;
    progress_ = std::make_unique<Progress>(logger_, label_, expected_);
  }
  progress_->Advance(std::exchange(unshown_, 0));
}

bool WatchedParallelFor(WorkWatch* watch, int64_t count, int64_t grain, int64_t steps,
                        const std::function<void(int64_t begin, int64_t end)>& body) {
  if (watch == nullptr) {
    ParallelFor(count, grain, body);
    return true;
  }
  std::atomic<bool> all = true;
  ParallelFor(count, grain, [&](int64_t begin, int64_t end) {
    if (watch->stopped()) {
      all = false;
      return;
    }
    body(begin, end);
    watch->Advance((end - begin) * steps);
  });
  return all;
}

}  // namespace stratalux::rig
