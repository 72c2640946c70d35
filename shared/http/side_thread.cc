// SPDX-License-Identifier: Apache-2.0
#include "shared/http/side_thread.h"

#include <system_error>
#include <utility>

namespace stratalux::http {

bool SideThread::Add(Piece piece, const std::function<void()>& before) {
  {
    const std::lock_guard lock(mutex_);
    if (stopping_ || waiting_.size() + (runs_ ? 1 : 0) > most_waiting_) return false;
    try {
      if (!thread_.joinable()) thread_ = std::thread([this] { Run(); });
    } catch (const std::system_error&) {
      return false;
    }
    waiting_.push_back(std::move(piece));
    before();
  }
  wake_.notify_one();
  return true;
}

void SideThread::Stop() {
  std::thread ending;
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    ending = std::exchange(thread_, {});
  }
  wake_.notify_one();
  if (ending.joinable()) ending.join();
}

void SideThread::Run() {
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return stopping_ || !waiting_.empty(); });
    if (waiting_.empty()) return;
    const Piece piece = std::exchange(waiting_.front(), nullptr);
    waiting_.pop_front();
    const bool stopping = stopping_;
    runs_ = true;
    lock.unlock();
    piece(stopping);
    lock.lock();
    runs_ = false;
  }
}

}  // namespace stratalux::http
