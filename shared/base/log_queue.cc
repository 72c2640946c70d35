// SPDX-License-Identifier: Apache-2.0
#include "shared/base/log_queue.h"

#include <algorithm>
#include <climits>
#include <condition_variable>
#include <csignal>
#include <cstdlib>
#include <deque>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include <pthread.h>
#include <sched.h>

namespace stratalux {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono_literals::operator""ms;

// How long a stuck sink keeps the writer from seeing that it is given up.
constexpr auto kLook = 20ms;

struct Entry {
  std::string bytes;
  int64_t lines = 0;  // lines that are lost with it: 0 progress, 1 a line, more: what a note of dropped lines tells of
  bool is_note = false;
};

struct Batch {
  std::string bytes;
  std::vector<Entry> entries;  // their bytes are empty
  size_t queued_bytes = 0;
};

// The writer must not run at the priority of a capture that happened to log first, nor answer the process's signals.
// Those of a crash stay: blocked, they would end the process without its handlers.
class WriterSignals {
 public:
  WriterSignals() {
    sigset_t mask;
    sigfillset(&mask);
    for (const int crash : {SIGSEGV, SIGBUS, SIGILL, SIGFPE, SIGABRT, SIGTRAP, SIGSYS}) sigdelset(&mask, crash);
    pthread_sigmask(SIG_SETMASK, &mask, &before_);
  }
  ~WriterSignals() { pthread_sigmask(SIG_SETMASK, &before_, nullptr); }
  WriterSignals(const WriterSignals&) = delete;
  WriterSignals& operator=(const WriterSignals&) = delete;

 private:
  sigset_t before_ = {};
};

}  // namespace

struct LogQueue::State {
  explicit State(std::shared_ptr<LogSink> where) : sink(std::move(where)) {}

  void Add(std::string bytes, int64_t lines, bool is_note);
  void AddNote();
  [[nodiscard]] bool MustTell() const { return untold > 0 && may_tell; }
  [[nodiscard]] bool IsIdle() const { return queued == 0 && !MustTell(); }
  Batch NextBatch();
  LogSink::Taken Deliver(std::string_view rest);
  void Settle(const Batch& batch, LogSink::Taken taken);
  static void Start(const std::shared_ptr<State>& state);
  static void Run(const std::shared_ptr<State>& state);

  const std::shared_ptr<LogSink> sink;
  std::mutex mutex;
  std::condition_variable work, idle;
  std::deque<Entry> entries;
  size_t queued = 0, bytes = 0;     // with what the writer has in hand
  int64_t dropped = 0, untold = 0;  // lines
  bool may_tell = true;             // false: the sink refused to be told, and nobody logged since
  bool running = false, closing = false, ended = false;
  bool stalled = false;  // somebody waited in vain, and nothing was taken since
  Clock::time_point end_by = Clock::time_point::max();
};

void LogQueue::State::Add(std::string text, int64_t lines, bool is_note) {
  ++queued;
  bytes += text.size();
  entries.push_back({std::move(text), lines, is_note});
}

void LogQueue::State::AddNote() {
  const int64_t count = std::exchange(untold, 0);
  const std::string what = count == 1 ? "1 line was" : std::to_string(count) + " lines were";
  Add(sink->Format(LogLevel::kWarning, what + " dropped: " + sink->name() + " did not take them", {}), count, true);
}

// What a pipe takes at once, or one line.
Batch LogQueue::State::NextBatch() {
  if (entries.empty()) AddNote();
  Batch batch;
  do {
    Entry entry = std::move(entries.front());
    entries.pop_front();
    batch.bytes += entry.bytes;
    entry.bytes.clear();
    batch.entries.push_back(std::move(entry));
  } while (!entries.empty() && sink->JoinsLines() && batch.bytes.size() + entries.front().bytes.size() <= PIPE_BUF);
  batch.queued_bytes = batch.bytes.size();
  return batch;
}

// kNotYet: given up.
LogSink::Taken LogQueue::State::Deliver(std::string_view rest) {
  while (true) {
    const size_t before = rest.size();
    const LogSink::Taken taken = sink->Take(rest, kLook);
    if (taken != LogSink::Taken::kNotYet) return taken;
    const std::lock_guard lock(mutex);
    if (rest.size() < before) stalled = false;
    if (Clock::now() >= end_by) return taken;
  }
}

void LogQueue::State::Settle(const Batch& batch, LogSink::Taken taken) {
  queued -= batch.entries.size();
  bytes -= batch.queued_bytes;
  if (taken == LogSink::Taken::kAll) {
    stalled = false;
    return;
  }
  for (const Entry& entry : batch.entries) {
    untold += entry.lines;
    if (entry.is_note)
      may_tell = false;
    else
      dropped += entry.lines;
  }
}

void LogQueue::State::Run(const std::shared_ptr<State>& state) {
  const sched_param ordinary = {};
  pthread_setschedparam(pthread_self(), SCHED_OTHER, &ordinary);
  pthread_setname_np(pthread_self(), "log");
  std::unique_lock lock(state->mutex);
  while (true) {
    state->work.wait(lock, [&] { return !state->entries.empty() || state->MustTell() || state->closing; });
    if (state->entries.empty() && !state->MustTell()) break;
    const Batch batch = state->NextBatch();
    lock.unlock();
    const LogSink::Taken taken = state->Deliver(batch.bytes);
    lock.lock();
    state->Settle(batch, taken);
    if (taken == LogSink::Taken::kNotYet || Clock::now() >= state->end_by) break;
    if (state->IsIdle()) state->idle.notify_all();
  }
  state->ended = true;
  state->idle.notify_all();
}

// Detached: it may never come back from the sink.
void LogQueue::State::Start(const std::shared_ptr<State>& state) {
  const WriterSignals blocked;
  try {
    std::thread(Run, state).detach();
    state->running = true;
  } catch (const std::system_error&) {
    // No thread to be had now: the next line tries again.
  }
}

// Never destroyed, so that whatever still logs when the process ends finds it.
struct LogQueue::Registry {
  std::mutex mutex;
  std::vector<LogQueue*> queues;
  // After a fork: the parent's states, whose locks may be held by threads that are not here. Not touched, not freed.
  std::vector<std::shared_ptr<State>> parents;
};

LogQueue::Registry& LogQueue::TheRegistry() {
  static Registry& registry = *[] {
    pthread_atfork([] { TheRegistry().mutex.lock(); }, [] { TheRegistry().mutex.unlock(); }, StartAfreshInChild);
    std::atexit([] { FlushLoggers(); });
    return new Registry;
  }();
  return registry;
}

void LogQueue::StartAfreshInChild() {
  Registry& registry = TheRegistry();
  for (LogQueue* queue : registry.queues) {
    auto fresh = std::make_shared<State>(queue->state_->sink);
    registry.parents.push_back(std::exchange(queue->state_, std::move(fresh)));
  }
  registry.mutex.unlock();
}

LogQueue::LogQueue(std::shared_ptr<LogSink> sink) : state_(std::make_shared<State>(std::move(sink))) {
  Registry& registry = TheRegistry();
  const std::lock_guard lock(registry.mutex);
  registry.queues.push_back(this);
}

LogQueue::~LogQueue() {
  {
    Registry& registry = TheRegistry();
    const std::lock_guard lock(registry.mutex);
    std::erase(registry.queues, this);
  }
  std::unique_lock lock(state_->mutex);
  state_->closing = true;
  state_->end_by = state_->stalled ? Clock::now() : Clock::now() + kPatience;
  state_->work.notify_all();
  if (state_->running) state_->idle.wait_until(lock, state_->end_by + 10 * kLook, [&] { return state_->ended; });
}

void LogQueue::Push(std::string bytes, Kind kind) {
  const std::lock_guard lock(state_->mutex);
  State& state = *state_;
  state.may_tell = true;
  if (state.queued >= kMaxLines || state.bytes + bytes.size() > kMaxBytes) {
    if (kind == Kind::kLine) ++state.dropped, ++state.untold;
  } else {
    if (state.untold > 0) state.AddNote();
    state.Add(std::move(bytes), kind == Kind::kLine ? 1 : 0, false);
  }
  if (!state.running) State::Start(state_);
  state.work.notify_one();
}

bool LogQueue::Flush(Clock::time_point deadline) {
  std::unique_lock lock(state_->mutex);
  const auto is_idle = [this] { return state_->IsIdle(); };
  if (state_->stalled) return is_idle();
  const bool written = state_->idle.wait_until(lock, deadline, is_idle);
  state_->stalled = !written;
  return written;
}

int64_t LogQueue::dropped() const {
  const std::lock_guard lock(state_->mutex);
  return state_->dropped;
}

const LogSink& LogQueue::sink() const { return *state_->sink; }

bool FlushLoggers() {
  const auto deadline = Clock::now() + LogQueue::kPatience;
  LogQueue::Registry& registry = LogQueue::TheRegistry();
  const std::lock_guard lock(registry.mutex);
  bool all = true;
  for (LogQueue* queue : registry.queues) all = queue->Flush(deadline) && all;
  return all;
}

}  // namespace stratalux
