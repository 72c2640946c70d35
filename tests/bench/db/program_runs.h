// SPDX-License-Identifier: Apache-2.0
// What a program costs that is started anew each time, as an operator starts it.
#pragma once

#include <string>
#include <vector>

namespace stratalux::db {

struct ProgramRuns {
  int exit_code = 0;                    // of the first run that did not end with 0; 127: there is no such program
  std::vector<double> cpu_ms, wall_ms;  // ascending; user and system time
  double peak_mb = 0.0;                 // resident, of the hungriest run
};

// One run that does not count, then `runs` that do; what the program prints goes nowhere. `command` is the shell's.
// A child begins with the memory of its parent, which counts into peak_mb: call it before this process has grown.
[[nodiscard]] ProgramRuns RunProgram(const std::string& command, int runs);

// Of ascending figures.
[[nodiscard]] double Least(const std::vector<double>& figures);
[[nodiscard]] double Median(const std::vector<double>& figures);

}  // namespace stratalux::db
