// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/interruption.h"

#include <chrono>
#include <csignal>
#include <mutex>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include <pthread.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "shared/base/log.h"

namespace stratalux::fit {
namespace {

// What tells a program to end may tell it twice: timeout(1) signals the program, then its group.
constexpr std::chrono::milliseconds kOneRequest{200};

// Never destroyed: the watching thread outlives main.
struct Registered {
  std::recursive_mutex mutex;
  std::multiset<std::filesystem::path> folders;
  std::mutex asking_mutex;
  int asking = -1;  // of InterruptionAsks
};
Registered& Folders() {
  static auto* const registered = new Registered;
  return *registered;
}

sigset_t Interruptions() {
  sigset_t set;
  sigemptyset(&set);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction action {};
    sigaction(signal, nullptr, &action);
    if (action.sa_handler != SIG_IGN) sigaddset(&set, signal);  // nohup
  }
  return set;
}

// True: somebody puts things in order first.
bool Asked() {
  const std::lock_guard lock(Folders().asking_mutex);
  const int asking = std::exchange(Folders().asking, -1);
  const uint64_t one = 1;
  return asking >= 0 && write(asking, &one, sizeof one) == sizeof one;
}

// For good: whoever else would register, make or rename a folder waits for the end of the process.
void RemoveAll() {
  Folders().mutex.lock();
  std::error_code error;
  // Another thread may be writing into them: a file that comes between the last look and the folder's end keeps it.
  for (const std::filesystem::path& folder : Folders().folders)
    for (int tries = 0; tries < 20 && std::filesystem::exists(folder, error); ++tries)
      std::filesystem::remove_all(folder, error);
}

void End(int signal) {
  FlushLoggers();
  std::signal(signal, SIG_DFL);
  sigset_t one;
  sigemptyset(&one);
  sigaddset(&one, signal);
  pthread_sigmask(SIG_UNBLOCK, &one, nullptr);
  kill(getpid(), signal);
  _exit(128 + signal);
}

}  // namespace

void RemoveOnInterruption() {
  const sigset_t set = Interruptions();
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
  std::thread([set] {
    int signal = 0;
    std::optional<std::chrono::steady_clock::time_point> asked;
    while (true) {
      if (sigwait(&set, &signal) != 0) return;
      const auto now = std::chrono::steady_clock::now();
      if (asked && now - *asked < kOneRequest) continue;
      if (!Asked()) break;
      asked = now;
    }
    RemoveAll();
    End(signal);
  }).detach();
}

InterruptionAsks::InterruptionAsks() : asked_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  const std::lock_guard lock(Folders().asking_mutex);
  Folders().asking = asked_.get();
}

InterruptionAsks::~InterruptionAsks() {
  const std::lock_guard lock(Folders().asking_mutex);
  Folders().asking = -1;
}

RemovedOnSignal::RemovedOnSignal(std::filesystem::path folder) : folder_(std::move(folder)) {
  const std::lock_guard lock(Folders().mutex);
  Folders().folders.insert(folder_);
}

RemovedOnSignal::~RemovedOnSignal() {
  const std::lock_guard lock(Folders().mutex);
  const auto found = Folders().folders.find(folder_);
  if (found != Folders().folders.end()) Folders().folders.erase(found);
}

Status MakeFoldersBelow(const std::filesystem::path& root, const std::filesystem::path& folders) {
  const NotInterrupted whole;  // nothing is made anew behind the removal of the folder that it lies in
  std::error_code error;
  if (!std::filesystem::is_directory(root, error)) return Status::Failed("folder " + root.string() + " is gone");
  std::filesystem::path folder = root;
  for (const std::filesystem::path& level : folders) {
    folder /= level;
    std::filesystem::create_directory(folder, error);
    if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());
  }
  return Status::Ok();
}

NotInterrupted::NotInterrupted() { Folders().mutex.lock(); }
NotInterrupted::~NotInterrupted() { Folders().mutex.unlock(); }

}  // namespace stratalux::fit
