// SPDX-License-Identifier: Apache-2.0
// Runs another program without a shell.
#pragma once

#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux {

struct ProgramOutcome {
  int code = 0;  // exit status; 128 + signal
  std::string output, errors;
};

// arguments[0] is looked up in PATH; stdin is empty. It is ended when the calling thread ends, also by SIGKILL.
// kNotFound where there is no such program.
[[nodiscard]] Result<ProgramOutcome> RunProgram(const std::vector<std::string>& arguments);

}  // namespace stratalux
