// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/stage_clock.h"

#include <algorithm>
#include <cstdio>

#include <sys/resource.h>

namespace stratalux::fit {

void StageClock::Start(const std::string& name) {
  Stop();
  name_ = name;
  start_ = std::chrono::steady_clock::now();
  logger_.Info(name + " ...");
}

void StageClock::Stop() {
  if (name_.empty()) return;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  auto found = std::find_if(stages_.begin(), stages_.end(), [&](const StageTime& s) { return s.name == name_; });
  if (found == stages_.end()) found = stages_.insert(stages_.end(), {name_, 0.0, 0});
  found->seconds += seconds;
  found->peak_rss_bytes = int64_t{usage.ru_maxrss} * 1024;
  char text[128];
  std::snprintf(text, sizeof text, "%s: %.1f s, peak %.2f GiB", name_.c_str(), seconds,
                static_cast<double>(usage.ru_maxrss) / (1024.0 * 1024.0));
  logger_.Info(text);
  name_.clear();
}

}  // namespace stratalux::fit
