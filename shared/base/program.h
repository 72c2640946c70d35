// SPDX-License-Identifier: Apache-2.0
// Runs another program without a shell.
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux {

struct ProgramOutcome {
  int code = 0;  // exit status; 128 + signal
  std::string output, errors;
};

using ProgramDeadline = std::optional<std::chrono::steady_clock::time_point>;

// arguments[0] is looked up in PATH; stdin is empty. It is ended when the calling thread ends, also by SIGKILL, and at
// the deadline: SIGTERM, and SIGKILL two seconds later; what it started itself is not waited for. kNotFound where there
// is no such program; kTryAgain where its time was over.
[[nodiscard]] Result<ProgramOutcome> RunProgram(const std::vector<std::string>& arguments,
                                                const ProgramDeadline& deadline = {});

}  // namespace stratalux
