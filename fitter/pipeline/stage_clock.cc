// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/stage_clock.h"

#include <algorithm>
#include <cstdio>

#include <sys/resource.h>

namespace stratalux::fit {
namespace {

double CpuSeconds(const rusage& usage) {
  auto seconds = [](const timeval& t) { return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec); };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

rusage Usage() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage;
}

}  // namespace

void StageClock::Start(const std::string& name) {
  Stop();
  name_ = name;
  start_ = std::chrono::steady_clock::now();
  cpu_start_ = CpuSeconds(Usage());
  logger_.Info(name + " ...");
}

void StageClock::Stop() {
  if (name_.empty()) return;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  const rusage usage = Usage();
  const double cpu_seconds = CpuSeconds(usage) - cpu_start_;
  auto found = std::find_if(stages_.begin(), stages_.end(), [&](const StageTime& s) { return s.name == name_; });
  if (found == stages_.end()) found = stages_.insert(stages_.end(), {name_, 0.0, 0.0, 0});
  found->seconds += seconds;
  found->cpu_seconds += cpu_seconds;
  found->peak_rss_bytes = int64_t{usage.ru_maxrss} * 1024;
  char text[128];
  std::snprintf(text, sizeof text, "%s: %.1f s (%.1f s of processor), peak %.2f GiB", name_.c_str(), seconds,
                cpu_seconds, static_cast<double>(usage.ru_maxrss) / (1024.0 * 1024.0));
  logger_.Info(text);
  name_.clear();
}

}  // namespace stratalux::fit
