// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/worker.h"

#include <cerrno>
#include <csignal>
#include <cstring>
#include <fstream>
#include <map>
#include <set>
#include <utility>

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/keys/held_keys.h"

namespace stratalux::fit {
namespace {

// Between fork and exec: only what is allowed in a signal handler.
struct Handed {
  int log, trouble, keys;  // keys: -1: none
};
[[noreturn]] void Become(char* const* argv, char* const* environment, const Handed& handed, pid_t parent, int nice_by) {
  sigset_t none;
  sigemptyset(&none);
  const int nothing = open("/dev/null", O_RDONLY | O_CLOEXEC);
  const bool ready = nothing >= 0 && dup2(nothing, 0) >= 0 && dup2(handed.log, 1) >= 0 && dup2(handed.log, 2) >= 0 &&
                     (handed.keys < 0 || fcntl(handed.keys, F_SETFD, 0) == 0) &&
                     prctl(PR_SET_PDEATHSIG, SIGKILL) == 0 && getppid() == parent &&
                     sigprocmask(SIG_SETMASK, &none, nullptr) == 0;
  if (ready) {
    // What the system refuses costs others politeness, nothing else.
    [[maybe_unused]] const int priority = nice(nice_by);
    constexpr int kOfProcess = 1, kIdleClass = 3 << 13;  // linux/ioprio.h
    (void)syscall(SYS_ioprio_set, kOfProcess, 0, kIdleClass);
    execve(argv[0], argv, environment);
  }
  const int reason = errno;
  [[maybe_unused]] const ssize_t written = write(handed.trouble, &reason, sizeof reason);
  _exit(127);
}

// This process's, without what leads to a reader's key, and with `own`.
std::vector<std::string> EnvironmentOf(const std::map<std::string, std::string>& own) {
  static const std::set<std::string> kWithheld = {"STRATALUX_READER_KEY", "CREDENTIALS_DIRECTORY",
                                                  db::kHeldKeysVariable};
  std::vector<std::string> all;
  for (char** one = environ; *one != nullptr; ++one) {
    const std::string name(*one, std::strcspn(*one, "="));
    if (!own.contains(name) && !kWithheld.contains(name)) all.emplace_back(*one);
  }
  for (const auto& [name, value] : own) all.push_back(name + "=" + value);
  return all;
}

// The end of a pipe that holds them. A visitor's key is smaller than any pipe: nobody need read while this writes.
Result<UniqueFd> PipeWith(const std::vector<db::SessionKey>& keys) {
  int ends[2] = {-1, -1};
  if (pipe2(ends, O_CLOEXEC | O_NONBLOCK) != 0)
    return Status::Failed(std::string("cannot create a pipe: ") + std::strerror(errno));
  UniqueFd out(ends[0]);
  const UniqueFd in(ends[1]);
  SLX_RETURN_IF_ERROR(db::WriteKeys(in.get(), keys));
  if (fcntl(out.get(), F_SETFL, 0) != 0)
    return Status::Failed(std::string("cannot set up a pipe: ") + std::strerror(errno));
  return out;
}

std::vector<char*> Pointers(const std::vector<std::string>& texts) {
  std::vector<char*> pointers;
  for (const std::string& text : texts) pointers.push_back(const_cast<char*>(text.c_str()));
  pointers.push_back(nullptr);
  return pointers;
}

Status Errno(const std::string& what) { return Status::Failed(what + ": " + std::strerror(errno)); }

}  // namespace

Result<Worker> Worker::Start(const WorkerOptions& options) {
  constexpr int kPrivate = 0640;
  const UniqueFd log(open(options.log.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, kPrivate));
  if (!log.ok()) return Errno(options.log.string());
  int ends[2] = {-1, -1};
  if (pipe2(ends, O_CLOEXEC) != 0) return Errno("cannot create a pipe");
  const UniqueFd heard(ends[0]);
  UniqueFd told(ends[1]);
  UniqueFd keys;
  std::map<std::string, std::string> own = {{"STRATALUX_THREADS", std::to_string(options.threads)}};
  if (!options.keys.empty()) {
    SLX_ASSIGN_OR_RETURN(keys, PipeWith(options.keys));
    own[db::kHeldKeysVariable] = std::to_string(keys.get());
  }
  const std::vector<std::string> variables = EnvironmentOf(own);
  const std::vector<char*> argv = Pointers(options.command), environment = Pointers(variables);
  const pid_t parent = getpid();
  const pid_t child = fork();
  if (child < 0) return Errno("cannot start a process for " + options.command[0]);
  if (child == 0) Become(argv.data(), environment.data(), {log.get(), told.get(), keys.get()}, parent, options.nice);
  told = UniqueFd();
  Worker worker(child, UniqueFd(static_cast<int>(syscall(SYS_pidfd_open, child, 0))));
  if (!worker.ended_.ok()) return Errno("pidfd_open");
  // Closed by the program's start.
  int reason = 0;
  if (read(heard.get(), &reason, sizeof reason) == static_cast<ssize_t>(sizeof reason))
    return Status::Failed("cannot run " + options.command[0] + ": " + std::strerror(reason));
  return worker;
}

Worker::Worker(Worker&& other) noexcept
    : pid_(std::exchange(other.pid_, -1)), ended_(std::move(other.ended_)), started_(other.started_) {}

Worker& Worker::operator=(Worker&& other) noexcept {
  std::swap(pid_, other.pid_);
  std::swap(ended_, other.ended_);
  std::swap(started_, other.started_);
  return *this;
}

Worker::~Worker() {
  if (pid_ < 0) return;
  Signal(SIGKILL);
  while (waitpid(pid_, nullptr, 0) < 0 && errno == EINTR) {
  }
}

void Worker::Signal(int signal) const {
  if (pid_ > 0) kill(pid_, signal);
}

std::optional<WorkerEnd> Worker::Ended() {
  int status = 0;
  rusage used{};
  if (pid_ < 0 || wait4(pid_, &status, WNOHANG, &used) != pid_) return std::nullopt;
  pid_ = -1;
  WorkerEnd end;
  if (WIFEXITED(status)) end.exit_code = WEXITSTATUS(status);
  if (WIFSIGNALED(status)) end.signal = WTERMSIG(status);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  end.cpu_seconds = seconds(used.ru_utime) + seconds(used.ru_stime);
  end.peak_bytes = int64_t{used.ru_maxrss} * 1024;
  return end;
}

int64_t Worker::ResidentBytes() const {
  std::ifstream file("/proc/" + std::to_string(pid_) + "/statm");
  int64_t size = 0, resident = 0;
  file >> size >> resident;
  return file ? resident * sysconf(_SC_PAGESIZE) : 0;
}

}  // namespace stratalux::fit
