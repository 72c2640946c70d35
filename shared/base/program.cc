// SPDX-License-Identifier: Apache-2.0
#include "shared/base/program.h"

#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>

#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

namespace stratalux {
namespace {

struct Pipe {
  std::array<int, 2> ends = {-1, -1};
  Pipe() {
    if (pipe2(ends.data(), O_CLOEXEC) != 0) ends = {-1, -1};
  }
  ~Pipe() {
    CloseEnd(0);
    CloseEnd(1);
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;
  void CloseEnd(size_t end) {
    if (ends[end] >= 0) close(ends[end]);
    ends[end] = -1;
  }
};

// Both at once: a program that fills one pipe waits while we wait for the other.
void Drain(Pipe& out, Pipe& err, ProgramOutcome& outcome) {
  std::array<char, 65536> block{};
  while (out.ends[0] >= 0 || err.ends[0] >= 0) {
    std::array<pollfd, 2> files = {pollfd{out.ends[0], POLLIN, 0}, pollfd{err.ends[0], POLLIN, 0}};
    if (poll(files.data(), files.size(), -1) < 0 && errno != EINTR) return;
    for (size_t i = 0; i < 2; ++i) {
      if (files[i].revents == 0) continue;
      const ssize_t got = read(files[i].fd, block.data(), block.size());
      if (got > 0) {
        (i == 0 ? outcome.output : outcome.errors).append(block.data(), static_cast<size_t>(got));
      } else if (got == 0 || errno != EINTR) {
        (i == 0 ? out : err).CloseEnd(0);
      }
    }
  }
}

// In the child, between fork and exec: only what is allowed in a signal handler. The program ends with us: should we be
// killed, it must not go on writing behind the back of whoever comes next.
[[noreturn]] void Become(char** argv, pid_t parent, const Pipe& out, const Pipe& err, const Pipe& trouble) {
  const int nothing = open("/dev/null", O_RDONLY);
  const bool ready = nothing >= 0 && dup2(nothing, 0) >= 0 && dup2(out.ends[1], 1) >= 0 && dup2(err.ends[1], 2) >= 0 &&
                     prctl(PR_SET_PDEATHSIG, SIGTERM) == 0 && getppid() == parent;
  if (ready) execvp(argv[0], argv);
  const int reason = errno;
  if (write(trouble.ends[1], &reason, sizeof reason) < 0) _exit(126);
  _exit(127);
}

}  // namespace

Result<ProgramOutcome> RunProgram(const std::vector<std::string>& arguments) {
  Pipe out, err, trouble;
  if (out.ends[0] < 0 || err.ends[0] < 0 || trouble.ends[0] < 0)
    return Status::Failed(std::string("no pipe: ") + std::strerror(errno));
  std::vector<char*> argv;
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  const pid_t parent = getpid();
  const pid_t child = fork();
  if (child < 0) return Status::Failed("cannot run " + arguments[0] + ": " + std::strerror(errno));
  if (child == 0) Become(argv.data(), parent, out, err, trouble);
  out.CloseEnd(1);
  err.CloseEnd(1);
  trouble.CloseEnd(1);
  ProgramOutcome outcome;
  Drain(out, err, outcome);
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  int reason = 0;
  if (read(trouble.ends[0], &reason, sizeof reason) == static_cast<ssize_t>(sizeof reason))
    return reason == ENOENT ? Status::NotFound("there is no program '" + arguments[0] + "'")
                            : Status::Failed("cannot run " + arguments[0] + ": " + std::strerror(reason));
  outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return outcome;
}

}  // namespace stratalux
