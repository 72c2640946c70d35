// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/safety/light_guard.h"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <limits>
#include <string>
#include <utility>

#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <sys/eventfd.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include "shared/base/check.h"

namespace stratalux::rig {
namespace {

using std::chrono::nanoseconds;

constexpr int64_t kNever = std::numeric_limits<int64_t>::max();
constexpr auto kLastTries = std::chrono::seconds(1);
// Of the dying, a millisecond apart: to have it dark, and for other threads that are about to write an 'on'. Beside
// real-time threads that never sleep the kernel leaves the others 50 ms of each second (sched_rt_runtime_us).
constexpr int kTriesOfTheDying = 50, kTriesForOthers = 1500;

// The guard whose light this thread is switching on. A handler must not wait for the thread that it interrupted.
__attribute__((tls_model("initial-exec"))) constinit thread_local const void* switching_here = nullptr;

// Above every thread that captures; without the right to, as any other.
bool BecomeUrgent() noexcept {
  rlimit limit{};
  int priority = sched_get_priority_max(SCHED_FIFO);  // captures stay below: rig_config.h
  sched_param parameters{.sched_priority = priority};
  if (pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters) == 0) return true;
  if (getrlimit(RLIMIT_RTPRIO, &limit) != 0 || limit.rlim_cur < 1) return false;
  priority = static_cast<int>(std::min<rlim_t>(limit.rlim_cur, static_cast<rlim_t>(priority)));
  parameters.sched_priority = priority;
  return pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters) == 0;
}

}  // namespace

std::array<std::atomic<LightGuard*>, LightGuard::kMaxGuards> LightGuard::guards{};
std::atomic<bool> LightGuard::dying = false;
std::atomic<void (*)() noexcept> LightGuard::answer_signals = nullptr;
std::atomic<int> LightGuard::signals_fd = -1;

LightGuard::LightGuard(StopToken& stop, InterlockInput* interlock, LightGuardOptions options)
    : stop_(stop), interlock_(interlock), options_(options), wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  SLX_CHECK(wake_.ok());
}

Result<std::unique_ptr<LightGuard>> LightGuard::Start(std::vector<std::vector<LightSwitch*>> projectors,
                                                      InterlockInput* interlock, StopToken& stop,
                                                      LightGuardOptions options) {
  if (projectors.size() > kMaxProjectors)
    return Status::Usage(std::to_string(projectors.size()) + " projectors; the guard of their light can take at most " +
                         std::to_string(kMaxProjectors));
  std::unique_ptr<LightGuard> guard(new LightGuard(stop, interlock, options));
  for (const std::vector<LightSwitch*>& switches : projectors) {
    SLX_CHECK(switches.size() <= kMaxSwitches);
    Light& light = guard->lights_[guard->count_++];
    for (LightSwitch* one : switches) light.switches[light.count++] = one;
  }
  if (!guard->Register())
    return Status::Busy("this process guards the light of " + std::to_string(kMaxGuards) + " rigs already");
  SetCheckFailureHook([] { TakeAllForEver(); });
  guard->Look();
  SLX_RETURN_IF_ERROR(guard->AllOff());
  guard->thread_ = std::thread([raw = guard.get()] { raw->Watch(); });
  while (!guard->watching_.load()) std::this_thread::yield();
  return guard;
}

LightGuard::~LightGuard() {
  // Dark first, whatever the thread is at.
  for (int p = 0; p < count_; ++p) lights_[p].until_ns.store(0);
  Enforce();
  ending_.store(true);
  const uint64_t one = 1;
  if (thread_.joinable()) {
    if (write(wake_.get(), &one, sizeof one) != sizeof one) stop_.Request(StopReason::kDying);
    thread_.join();
  }
  const auto end = std::chrono::steady_clock::now() + kLastTries;
  while (!Enforce() && std::chrono::steady_clock::now() < end) std::this_thread::sleep_for(options_.watch_period);
  for (std::atomic<LightGuard*>& place : guards) {
    LightGuard* self = this;
    place.compare_exchange_strong(self, nullptr);
  }
}

bool LightGuard::Register() noexcept {
  for (std::atomic<LightGuard*>& place : guards) {
    LightGuard* none = nullptr;
    if (place.compare_exchange_strong(none, this)) return true;
  }
  return false;
}

MonotonicNs LightGuard::Now() const noexcept {
  return options_.clock != nullptr ? options_.clock->Now() : MonotonicNow();
}

void LightGuard::Look() noexcept {
  if (interlock_ != nullptr)
    if (const StopReason reason = interlock_->Take(); reason != StopReason::kNone) stop_.Request(reason);
  const int64_t now = Now().ns;
  for (int p = 0; p < count_; ++p) {
    const int64_t until = lights_[p].until_ns.load();
    if (until == 0 || now < until) continue;
    stop_.Request(until >= lights_[p].limit_ns.load() ? StopReason::kOnTimeLimit : StopReason::kLeaseExpired);
  }
}

bool LightGuard::Darken(Light& light, bool waiting) noexcept {
  bool dark = true;
  for (int i = 0; i < light.count; ++i) {
    LightSwitch& one = *light.switches[i];
    if (one.may_wait() != waiting) continue;
    bool on = true;
    int error = one.Read(on);
    if (error != 0 || on || !light.confirmed.load()) {
      if (light.until_ns.load() != 0 && !stop_.stopped()) return true;  // switched on meanwhile, rightly
      error = one.Set(false);
      on = true;
      if (const int unread = one.Read(on); error == 0) error = unread;
    }
    if (error == 0 && !on) continue;
    dark = false;
    light.error.store(error);
    light.failed.store(&one);
  }
  return dark;
}

bool LightGuard::Enforce() noexcept {
  const bool stopped = stop_.stopped() || dying.load();
  std::array<bool, kMaxProjectors> dark{};
  for (int p = 0; p < count_; ++p) {
    if (stopped) lights_[p].until_ns.store(0);
    dark[p] = lights_[p].until_ns.load() == 0;
  }
  bool all = true;
  // What answers at once comes first, of all projectors.
  for (int p = 0; p < count_; ++p)
    if (dark[p]) dark[p] = Darken(lights_[p], false);
  for (int p = 0; p < count_; ++p) {
    Light& light = lights_[p];
    if (light.until_ns.load() == 0) {
      const bool rest = Darken(light, true);
      light.confirmed.store(dark[p] && rest);
      all = all && dark[p] && rest;
      continue;
    }
    bool on = true;
    for (int i = 0; i < light.count; ++i)
      if (light.switches[i]->Read(on) != 0) stop_.Request(StopReason::kLinesGone);
  }
  return all;
}

Status LightGuard::MayBeLit(int projector) const {
  const Light& light = lights_[projector];
  const LightSwitch* failed = light.failed.load();
  const int error = light.error.load();
  return Status::Failed("projector " + std::to_string(projector) +
                        " may still be lit: " + (failed != nullptr ? failed->name() : "its switch") + ": " +
                        (error != 0 ? std::strerror(error) : "stays on although it was switched off") +
                        "; the guard keeps trying; cut the lamp's power supply if it is lit");
}

Status LightGuard::On(int projector, const LightLease& lease) {
  SLX_CHECK(lease.length.count() > 0 && lease.longest.count() >= 0);
  if (projector < 0 || projector >= count_)
    return Status::Usage("projector " + std::to_string(projector) + " does not exist");
  const std::string stays_dark = "projector " + std::to_string(projector) + " stays dark";
  Light& light = lights_[projector];
  ++switching_;
  switching_here = this;
  int refused = 0;
  LightSwitch* refuser = nullptr;
  Status may = Check();
  if (may.ok()) {
    const int64_t now = Now().ns;
    if (light.until_ns.load() == 0)
      light.limit_ns.store(lease.longest.count() > 0 ? now + lease.longest.count() : kNever);
    light.length_ns.store(lease.length.count());
    light.until_ns.store(std::min(now + lease.length.count(), light.limit_ns.load()));
    // After the lease: whoever finds it unconfirmed finds it leased, and writes no 'off' over what comes.
    light.confirmed.store(false);
    for (int i = 0; i < light.count && refused == 0; ++i) {
      refused = light.switches[i]->Set(true);
      if (refused != 0) refuser = light.switches[i];
    }
    // Stopped in between: whoever stopped may have written its 'off' before our 'on'.
    may = stop_.Check();
    if (dying.load()) may = Status::Failed(ToString(StopReason::kDying));
  }
  switching_here = nullptr;
  --switching_;
  if (may.ok() && refused == 0) {
    const uint64_t one = 1;
    static_cast<void>(!write(wake_.get(), &one, sizeof one));  // sooner than its rest; full means awake
    return Status::Ok();
  }
  const Status off = Off(projector);
  if (!may.ok()) return may.WithContext(stays_dark);
  if (!off.ok()) return off;
  return Status::Failed(stays_dark + ": " + refuser->name() + ": " + std::strerror(refused));
}

Status LightGuard::Renew() {
  SLX_RETURN_IF_ERROR(Check());
  const int64_t now = Now().ns;
  for (int p = 0; p < count_; ++p) {
    Light& light = lights_[p];
    int64_t until = light.until_ns.load();
    // A lease that the guard ended meanwhile stays ended.
    while (until != 0 && !light.until_ns.compare_exchange_weak(
                             until, std::min(now + light.length_ns.load(), light.limit_ns.load()))) {
    }
  }
  return stop_.Check();
}

Status LightGuard::Off(int projector) {
  if (projector < 0 || projector >= count_)
    return Status::Usage("projector " + std::to_string(projector) + " does not exist");
  Light& light = lights_[projector];
  light.until_ns.store(0);
  light.confirmed.store(false);
  const bool at_once = Darken(light, false), rest = Darken(light, true);
  light.confirmed.store(at_once && rest);
  return at_once && rest ? Status::Ok() : MayBeLit(projector);
}

Status LightGuard::AllOff() {
  for (int p = 0; p < count_; ++p) {
    lights_[p].until_ns.store(0);
    lights_[p].confirmed.store(false);
  }
  if (Enforce()) return Status::Ok();
  for (int p = 0; p < count_; ++p)
    if (!lights_[p].confirmed.load()) return MayBeLit(p);
  return Status::Ok();
}

Status LightGuard::Check() {
  Look();
  if (!stop_.stopped()) return Status::Ok();
  Enforce();
  return stop_.Check();
}

Status LightGuard::Reset() {
  if (interlock_ != nullptr) {
    // What was pressed for a moment is told by the first call; what is active still, by every one.
    static_cast<void>(interlock_->Take());
    const StopReason still = interlock_->Take();
    if (still != StopReason::kNone) return Status::Failed(std::string(ToString(still)) + " is still active");
  }
  SLX_RETURN_IF_ERROR(AllOff());
  if (dying.load()) return Status::Failed(ToString(StopReason::kDying));
  stop_.Reset();
  return Status::Ok();
}

void LightGuard::TakeAllForEver() noexcept {
  const int before = errno;
  dying.store(true);
  for (std::atomic<LightGuard*>& place : guards)
    if (LightGuard* guard = place.load(); guard != nullptr) guard->TakeForEver();
  errno = before;
}

void LightGuard::MeetSignals(int fd, void (*answer)() noexcept) noexcept {
  answer_signals.store(answer);
  signals_fd.store(fd);
}

void LightGuard::TakeForEver() noexcept {
  // Wakes the guard's thread, too: a handler's own may get no processor from here on.
  stop_.Request(StopReason::kDying);
  for (int p = 0; p < count_; ++p) lights_[p].confirmed.store(false);
  for (int tries = 0;; ++tries) {
    const bool dark = Enforce();
    // A thread may have asked before and be about to write its 'on'; it asks again afterwards.
    const int others = switching_.load() - static_cast<int>(switching_here == this);
    if (dark && others <= 0) return;
    if (tries >= (dark ? kTriesForOthers : kTriesOfTheDying)) return;
    poll(nullptr, 0, 1);
  }
}

nanoseconds LightGuard::Pause(bool enforced) const noexcept {
  if (!enforced || stop_.stopped()) return options_.watch_period;
  nanoseconds pause = options_.rest_period;
  const int64_t now = Now().ns;
  for (int p = 0; p < count_; ++p) {
    const int64_t until = lights_[p].until_ns.load();
    if (until == 0) continue;
    pause = std::min({pause, options_.watch_period, nanoseconds(std::max<int64_t>(until - now, 0))});
  }
  return pause;
}

void LightGuard::Watch() noexcept {
  // Never interrupted, but by its own faults: what is sent to the process it takes from `signals_fd`, in its turn.
  sigset_t all;
  sigfillset(&all);
  for (const int fault : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGTRAP, SIGSYS}) sigdelset(&all, fault);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);
  prctl(PR_SET_NAME, "light-guard");
  realtime_.store(BecomeUrgent());
  watching_.store(true);
  while (!ending_.load()) {
    Look();
    const nanoseconds pause = Pause(Enforce());
    const timespec limit{.tv_sec = static_cast<time_t>(pause.count() / 1'000'000'000),
                         .tv_nsec = static_cast<long>(pause.count() % 1'000'000'000)};
    // Once stopped, the token's descriptor stays readable.
    const bool stopped = stop_.stopped();
    pollfd events[] = {{stopped ? -1 : stop_.fd(), POLLIN, 0},
                       {wake_.get(), POLLIN, 0},
                       {interlock_ != nullptr && !stopped ? interlock_->fd() : -1, POLLIN, 0},
                       {signals_fd.load(), POLLIN, 0}};
    ppoll(events, std::size(events), &limit, nullptr);
    if ((events[3].revents & POLLIN) != 0) answer_signals.load()();
    uint64_t count = 0;
    if ((events[1].revents & POLLIN) != 0) static_cast<void>(!read(wake_.get(), &count, sizeof count));
  }
}

}  // namespace stratalux::rig
