// SPDX-License-Identifier: Apache-2.0
#include "shared/base/program.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdint>
#include <cstring>
#include <limits>

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

// Milliseconds of poll(2): rounded up, so that it does not end too early; -1: without end.
int PatienceUntil(const ProgramDeadline& deadline) {
  if (!deadline) return -1;
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(*deadline - std::chrono::steady_clock::now()).count();
  return static_cast<int>(std::clamp<int64_t>(left, 0, std::numeric_limits<int>::max()));
}

// Both at once: a program that fills one pipe waits while we wait for the other. False where its time is over before it
// has closed both.
bool Drain(Pipe& out, Pipe& err, const ProgramDeadline& deadline, ProgramOutcome& outcome) {
  std::array<char, 65536> block{};
  while (out.ends[0] >= 0 || err.ends[0] >= 0) {
    std::array<pollfd, 2> files = {pollfd{out.ends[0], POLLIN, 0}, pollfd{err.ends[0], POLLIN, 0}};
    const int ready = poll(files.data(), files.size(), PatienceUntil(deadline));
    if (ready < 0 && errno != EINTR) return true;
    if (deadline && std::chrono::steady_clock::now() >= *deadline) return false;
    if (ready <= 0) continue;
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
  return true;
}

// Reaps it.
int End(pid_t child) {
  constexpr int kLooks = 200;  // each 10 ms
  int status = 0;
  kill(child, SIGTERM);
  for (int look = 0; look < kLooks; ++look) {
    if (waitpid(child, &status, WNOHANG) == child) return status;
    poll(nullptr, 0, 10);
  }
  kill(child, SIGKILL);
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return status;
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

Result<ProgramOutcome> RunProgram(const std::vector<std::string>& arguments, const ProgramDeadline& deadline) {
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
  if (!Drain(out, err, deadline, outcome)) {
    End(child);
    return Status(StatusCode::kTryAgain, arguments[0] + " was ended: its time was over");
  }
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
