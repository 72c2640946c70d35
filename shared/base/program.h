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

// arguments[0] is looked up in PATH; stdin is empty. It is ended when the calling thread ends, also by SIGKILL. Of our
// environment it gets all but what systemd gave to us alone: a program that inherits NOTIFY_SOCKET speaks in our name.
// kNotFound where there is no such program. With `limit` the program and what it starts are ended then, whatever they
// do with signals: kFailed, but where the program itself has ended, and left others behind that hold its output.
[[nodiscard]] Result<ProgramOutcome> RunProgram(const std::vector<std::string>& arguments,
                                                std::optional<std::chrono::milliseconds> limit = std::nullopt);

}  // namespace stratalux
