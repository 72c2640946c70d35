// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/db/program_runs.h"

#include <algorithm>
#include <chrono>

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

namespace stratalux::db {
namespace {

double Ms(const timeval& t) { return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_usec) / 1e3; }

struct Run {
  int exit_code = 127;
  rusage usage{};
};

Run RunOnce(const std::string& command) {
  Run run;
  const pid_t child = fork();
  if (child == 0) {
    const int null = open("/dev/null", O_RDWR);
    for (int fd = 0; fd < 3; ++fd) dup2(null, fd);
    execl("/bin/sh", "sh", "-c", ("exec " + command).c_str(), nullptr);
    _exit(127);
  }
  int status = 0;
  if (child > 0 && wait4(child, &status, 0, &run.usage) == child && WIFEXITED(status))
    run.exit_code = WEXITSTATUS(status);
  return run;
}

}  // namespace

ProgramRuns RunProgram(const std::string& command, int runs) {
  ProgramRuns all;
  all.exit_code = RunOnce(command).exit_code;
  for (int i = 0; i < runs && all.exit_code == 0; ++i) {
    const auto start = std::chrono::steady_clock::now();
    const Run run = RunOnce(command);
    const std::chrono::duration<double, std::milli> wall = std::chrono::steady_clock::now() - start;
    all.exit_code = run.exit_code;
    all.wall_ms.push_back(wall.count());
    all.cpu_ms.push_back(Ms(run.usage.ru_utime) + Ms(run.usage.ru_stime));
    all.peak_mb = std::max(all.peak_mb, static_cast<double>(run.usage.ru_maxrss) * 1024e-6);
  }
  std::sort(all.cpu_ms.begin(), all.cpu_ms.end());
  std::sort(all.wall_ms.begin(), all.wall_ms.end());
  return all;
}

double Least(const std::vector<double>& figures) { return figures.empty() ? 0.0 : figures.front(); }
double Median(const std::vector<double>& figures) { return figures.empty() ? 0.0 : figures[figures.size() / 2]; }

}  // namespace stratalux::db
