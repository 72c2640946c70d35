// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/program.h"

#include <array>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

extern char** environ;

namespace stratalux::db {
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

}  // namespace

Result<ProgramOutcome> RunProgram(const std::vector<std::string>& arguments) {
  Pipe out, err;
  if (out.ends[0] < 0 || err.ends[0] < 0) return Status::Failed(std::string("no pipe: ") + std::strerror(errno));
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, out.ends[1], 1);
  posix_spawn_file_actions_adddup2(&actions, err.ends[1], 2);
  std::vector<char*> argv;
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  pid_t child = 0;
  const int failed = posix_spawnp(&child, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (failed == ENOENT) return Status::NotFound("there is no program '" + arguments[0] + "'");
  if (failed != 0) return Status::Failed("cannot run " + arguments[0] + ": " + std::strerror(failed));
  out.CloseEnd(1);
  err.CloseEnd(1);
  ProgramOutcome outcome;
  Drain(out, err, outcome);
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return outcome;
}

}  // namespace stratalux::db
