// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/events/node_watch.h"

#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <string_view>
#include <utility>

#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <sys/inotify.h>
#include <unistd.h>

namespace stratalux::rig {
namespace {

// Rights and by-name links of a new node, and libraries that learn of it on their own way, come a little later than it:
// after a change, and while the device is away, it is asked for in these steps.
constexpr int kSettleStepMs = 100, kAwayStepMs = 250;
constexpr int kSettleSteps = 20;

}  // namespace

NodeWatch::NodeWatch(WatchedDevice device, RigEvents& events, UniqueFd changes, UniqueFd ending)
    : device_(std::move(device)), events_(events), changes_(std::move(changes)), ending_(std::move(ending)) {}

Result<std::unique_ptr<NodeWatch>> NodeWatch::Start(const std::string& folder, WatchedDevice device,
                                                    RigEvents& events) {
  UniqueFd changes(inotify_init1(IN_NONBLOCK | IN_CLOEXEC));
  constexpr uint32_t kMask = IN_CREATE | IN_DELETE | IN_MOVED_FROM | IN_MOVED_TO | IN_ATTRIB | IN_ONLYDIR;
  if (!changes.ok() || inotify_add_watch(changes.get(), folder.c_str(), kMask) < 0)
    return Status::Failed(folder + ": cannot be watched for devices that come and go: " + std::strerror(errno));
  UniqueFd ending(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!ending.ok()) return Status::Failed(std::string("eventfd: ") + std::strerror(errno));
  std::unique_ptr<NodeWatch> watch(new NodeWatch(std::move(device), events, std::move(changes), std::move(ending)));
  watch->thread_ = std::thread([raw = watch.get()] { raw->Watch(); });
  return watch;
}

NodeWatch::~NodeWatch() {
  const uint64_t one = 1;
  // Cannot fail: nobody else writes there.
  static_cast<void>(!write(ending_.get(), &one, sizeof one));
  if (thread_.joinable()) thread_.join();
}

bool NodeWatch::ReadChanges() {
  bool any = false;
  alignas(inotify_event) std::array<char, 4096> buffer;
  while (true) {
    const ssize_t bytes = read(changes_.get(), buffer.data(), buffer.size());
    if (bytes < 0 && errno == EINTR) continue;
    if (bytes <= 0) return any;
    for (ssize_t at = 0; at < bytes;) {
      inotify_event event{};
      std::memcpy(&event, buffer.data() + at, sizeof event);
      // A name is padded with zeros.
      const std::string_view name =
          event.len > 0 ? std::string_view(buffer.data() + at + sizeof event) : std::string_view();
      if ((event.mask & IN_IGNORED) != 0) blind_ = true;
      any = any || (event.mask & (IN_Q_OVERFLOW | IN_IGNORED)) != 0 || name.starts_with(device_.prefix);
      at += static_cast<ssize_t>(sizeof event + event.len);
    }
  }
}

void NodeWatch::Watch() {
  // Handlers run on other threads.
  sigset_t all;
  sigfillset(&all);
  for (const int fatal : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT}) sigdelset(&all, fatal);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);
  int settling = 1;
  while (true) {
    bool there = true;
    if (settling > 0 || blind_ || events_.IsActive(device_.signal)) {
      there = device_.is_there();
      events_.Tell(device_.signal, there ? SignalLevel::kRest : SignalLevel::kActive, MonotonicNow());
      if (settling > 0) --settling;
    }
    const int wait = settling > 0 ? kSettleStepMs : there && !blind_ ? -1 : kAwayStepMs;
    std::array<pollfd, 2> fds = {pollfd{ending_.get(), POLLIN, 0}, pollfd{changes_.get(), POLLIN, 0}};
    poll(fds.data(), fds.size(), wait);
    if (fds[0].revents != 0) return;
    if (fds[1].revents != 0 && ReadChanges()) settling = kSettleSteps;
  }
}

}  // namespace stratalux::rig
