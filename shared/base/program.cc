// SPDX-License-Identifier: Apache-2.0
#include "shared/base/program.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <string_view>
#include <thread>

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

using Clock = std::chrono::steady_clock;
using Deadline = std::optional<Clock::time_point>;

// For poll: -1 without a deadline.
int MillisecondsUntil(const Deadline& deadline) {
  if (!deadline) return -1;
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(*deadline - Clock::now()).count();
  return static_cast<int>(std::clamp<int64_t>(left, 0, 60'000));
}

bool IsOver(const Deadline& deadline) { return deadline && Clock::now() >= *deadline; }

// Both at once: a program that fills one pipe waits while we wait for the other.
void Drain(Pipe& out, Pipe& err, const Deadline& deadline, ProgramOutcome& outcome) {
  std::array<char, 65536> block{};
  while ((out.ends[0] >= 0 || err.ends[0] >= 0) && !IsOver(deadline)) {
    std::array<pollfd, 2> files = {pollfd{out.ends[0], POLLIN, 0}, pollfd{err.ends[0], POLLIN, 0}};
    if (poll(files.data(), files.size(), MillisecondsUntil(deadline)) < 0 && errno != EINTR) return;
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

// Waits until the child has ended, and leaves it to be waited for: its group keeps its number.
bool HasEnded(pid_t child, const Deadline& deadline) {
  siginfo_t ended{};
  const int now_or_later = deadline ? WNOHANG : 0;
  for (;;) {
    const int waited = waitid(P_PID, static_cast<id_t>(child), &ended, WEXITED | WNOWAIT | now_or_later);
    if (waited != 0 && errno != EINTR) return true;
    if (waited == 0 && ended.si_pid == child) return true;
    if (IsOver(deadline)) return false;
    if (deadline) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
}

std::vector<char*> EnvironmentOfOthers() {
  constexpr std::array<std::string_view, 6> kOurs = {"NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC",
                                                     "LISTEN_PID",    "LISTEN_FDS",   "LISTEN_FDNAMES"};
  std::vector<char*> variables;
  for (char** variable = environ; *variable != nullptr; ++variable) {
    const std::string_view text = *variable;
    if (std::find(kOurs.begin(), kOurs.end(), text.substr(0, text.find('='))) == kOurs.end())
      variables.push_back(*variable);
  }
  variables.push_back(nullptr);
  return variables;
}

struct Child {
  char** argv = nullptr;
  char** variables = nullptr;
  pid_t parent = 0;
  bool in_own_group = false;
};

// In the child, between fork and exec: only what is allowed in a signal handler. The program ends with us: should we be
// killed, it must not go on writing behind the back of whoever comes next.
[[noreturn]] void Become(const Child& child, const Pipe& out, const Pipe& err, const Pipe& trouble) {
  // What our threads block or ignore is no affair of the program's.
  sigset_t none;
  sigemptyset(&none);
  signal(SIGPIPE, SIG_DFL);
  const int nothing = open("/dev/null", O_RDONLY);
  const bool ready = nothing >= 0 && dup2(nothing, 0) >= 0 && dup2(out.ends[1], 1) >= 0 && dup2(err.ends[1], 2) >= 0 &&
                     (!child.in_own_group || setpgid(0, 0) == 0) &&
                     prctl(PR_SET_PDEATHSIG, child.in_own_group ? SIGKILL : SIGTERM) == 0 &&
                     getppid() == child.parent && sigprocmask(SIG_SETMASK, &none, nullptr) == 0;
  if (ready) execvpe(child.argv[0], child.argv, child.variables);
  const int reason = errno;
  if (write(trouble.ends[1], &reason, sizeof reason) < 0) _exit(126);
  _exit(127);
}

}  // namespace

Result<ProgramOutcome> RunProgram(const std::vector<std::string>& arguments, const std::optional<ProgramLimit>& limit) {
  Pipe out, err, trouble;
  if (out.ends[0] < 0 || err.ends[0] < 0 || trouble.ends[0] < 0)
    return Status::Failed(std::string("cannot create a pipe: ") + std::strerror(errno));
  std::vector<char*> argv;
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  std::vector<char*> variables = EnvironmentOfOthers();
  const Child its{argv.data(), variables.data(), getpid(), limit.has_value()};
  const Deadline deadline = limit ? Deadline(Clock::now() + limit->time) : std::nullopt;
  const pid_t child = fork();
  if (child < 0) return Status::Failed("cannot run " + arguments[0] + ": " + std::strerror(errno));
  if (child == 0) Become(its, out, err, trouble);
  out.CloseEnd(1);
  err.CloseEnd(1);
  trouble.CloseEnd(1);
  ProgramOutcome outcome;
  Drain(out, err, deadline, outcome);
  const bool ended = HasEnded(child, deadline);
  if (limit && !ended && limit->grace.count() > 0) {
    kill(-child, SIGTERM);
    const Deadline grace = Clock::now() + limit->grace;
    Drain(out, err, grace, outcome);
    (void)HasEnded(child, grace);
  }
  if (limit) {
    kill(-child, SIGKILL);             // what it left behind
    if (!ended) kill(child, SIGKILL);  // it may not have come to its group yet
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (!ended)
    return Status(StatusCode::kTryAgain,
                  arguments[0] + " did not end within " + std::to_string(limit->time.count()) + " ms");
  int reason = 0;
  if (read(trouble.ends[0], &reason, sizeof reason) == static_cast<ssize_t>(sizeof reason))
    return reason == ENOENT ? Status::NotFound("there is no program '" + arguments[0] + "'")
                            : Status::Failed("cannot run " + arguments[0] + ": " + std::strerror(reason));
  outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return outcome;
}

}  // namespace stratalux
