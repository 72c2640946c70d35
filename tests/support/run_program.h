// SPDX-License-Identifier: Apache-2.0
// The programs of this build, run in a shell as a user does.
#pragma once

#include <cstdio>
#include <string>

#include <sys/wait.h>

namespace stratalux {

struct Outcome {
  int code = -1;   // exit code; -1: a signal ended the program, or it never ran
  int signal = 0;  // that signal
  std::string out, err;
};

// Runs `command`; its stdout is kept, its stderr goes where the command sends it and `err` stays empty.
[[nodiscard]] inline Outcome Shell(const std::string& command) {
  Outcome outcome;
  std::FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) return outcome;
  char buffer[4096];
  for (size_t n = 0; (n = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;) outcome.out.append(buffer, n);
  const int status = pclose(pipe);
  if (WIFEXITED(status)) outcome.code = WEXITSTATUS(status);
  if (WIFSIGNALED(status)) outcome.signal = WTERMSIG(status);
  return outcome;
}

enum class Show { kStdout, kAll };

// Runs `program arguments`; `out` is what it printed: stdout and stderr as they came, or stdout alone.
[[nodiscard]] inline Outcome Execute(const std::string& program_and_arguments, Show show = Show::kAll) {
  return Shell(std::string(STRATALUX_BIN_DIR) + "/" + program_and_arguments +
               (show == Show::kAll ? " 2>&1" : " 2>/dev/null"));
}

}  // namespace stratalux
