// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/stopwatch.h"

#include <sys/resource.h>

namespace stratalux::fit {
namespace {

rusage Usage() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage;
}

double CpuSecondsOf(const rusage& usage) {
  auto seconds = [](const timeval& t) { return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec); };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

}  // namespace

Stopwatch::Stopwatch() : start_(std::chrono::steady_clock::now()), cpu_start_(CpuSecondsOf(Usage())) {}

double Stopwatch::Seconds() const {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
}

double Stopwatch::CpuSeconds() const { return CpuSecondsOf(Usage()) - cpu_start_; }

int64_t PeakRssBytes() { return int64_t{Usage().ru_maxrss} * 1024; }

}  // namespace stratalux::fit
