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

// After `time` the program and what it started are asked to end (SIGTERM), `grace` later made to (SIGKILL), whatever
// they do with signals; without a grace at once.
struct ProgramLimit {
  std::chrono::milliseconds time;
  std::chrono::milliseconds grace{0};
};

// arguments[0] is looked up in PATH; stdin is empty. It is ended when the calling thread ends, also by SIGKILL. Of our
// environment it gets all but what systemd gave to us alone: a program that inherits NOTIFY_SOCKET speaks in our name.
// kNotFound where there is no such program. kTryAgain where its time was over, but where the program itself has ended,
// and left others behind that hold its output.
[[nodiscard]] Result<ProgramOutcome> RunProgram(const std::vector<std::string>& arguments,
                                                const std::optional<ProgramLimit>& limit = std::nullopt);

}  // namespace stratalux
