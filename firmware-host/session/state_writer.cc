// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/state_writer.h"

#include <chrono>
#include <utility>

#include "firmware-host/session/state_file.h"

namespace stratalux::rig {
namespace {

constexpr auto kAgain = std::chrono::seconds(10);

}  // namespace

StateWriter::StateWriter(std::filesystem::path file, Logger& logger)
    : file_(std::move(file)), logger_(logger), thread_([this] { Work(); }) {}

StateWriter::~StateWriter() {
  {
    const std::scoped_lock lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void StateWriter::Keep(std::string json) {
  {
    const std::scoped_lock lock(mutex_);
    waiting_ = std::move(json);
  }
  changed_.notify_all();
}

std::string StateWriter::trouble() const {
  const std::scoped_lock lock(mutex_);
  return trouble_;
}

void StateWriter::Work() {
  std::string writing;
  bool unwritten = false;  // `writing`, by a try that failed
  std::unique_lock lock(mutex_);
  while (true) {
    const auto woken = [this] { return ending_ || waiting_; };
    if (unwritten)
      changed_.wait_for(lock, kAgain, woken);
    else
      changed_.wait(lock, woken);
    if (waiting_) {
      writing = *std::exchange(waiting_, std::nullopt);
      unwritten = true;
    }
    if (!unwritten) return;
    const bool last = ending_;
    lock.unlock();
    const Status kept = KeepState(file_, writing);
    lock.lock();
    unwritten = !kept.ok();
    Note(kept);
    if (last && !waiting_) return;
  }
}

void StateWriter::Note(const Status& kept) {
  if (!kept.ok() && trouble_.empty()) logger_.Warning("not saved, will be tried again: " + kept.message());
  if (kept.ok() && !trouble_.empty()) logger_.Info(file_.string() + " is saved again");
  trouble_ = kept.ok() ? "" : kept.message();
}

}  // namespace stratalux::rig
