// SPDX-License-Identifier: Apache-2.0
// BoundedQueue: between the thread that shoots and the thread that writes. It stops rather than drops: whoever pushes
// waits for space, so a slow disk slows the capture and loses nothing.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

namespace stratalux::rig {

// Thread-safe. One item type, any number of producers and consumers.
template <typename T>
class BoundedQueue {
 public:
  explicit BoundedQueue(size_t capacity) : capacity_(capacity) {}

  // Waits for space, `time` at most; the item is moved from only when it went in. False: no space, or closed.
  [[nodiscard]] bool PushFor(std::chrono::milliseconds time, T& item) {
    std::unique_lock lock(mutex_);
    if (!space_.wait_for(lock, time, [&] { return closed_ || items_.size() < capacity_; }) || closed_) return false;
    items_.push_back(std::move(item));
    filled_.notify_one();
    return true;
  }

  // Blocks for the next item; nullopt once the queue is closed and empty.
  [[nodiscard]] std::optional<T> Pop() {
    std::unique_lock lock(mutex_);
    filled_.wait(lock, [&] { return closed_ || !items_.empty(); });
    return TakeFront();
  }

  // As Pop(), but waits for `time` at most; nullopt then, too (exhausted() tells which).
  [[nodiscard]] std::optional<T> PopFor(std::chrono::milliseconds time) {
    std::unique_lock lock(mutex_);
    filled_.wait_for(lock, time, [&] { return closed_ || !items_.empty(); });
    return TakeFront();
  }

  // No more items; those inside are still popped.
  void Close() {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    space_.notify_all();
    filled_.notify_all();
  }

  [[nodiscard]] bool closed() const {
    const std::lock_guard lock(mutex_);
    return closed_;
  }

  // Closed and empty: no item will come any more.
  [[nodiscard]] bool exhausted() const {
    const std::lock_guard lock(mutex_);
    return closed_ && items_.empty();
  }

  [[nodiscard]] size_t size() const {
    const std::lock_guard lock(mutex_);
    return items_.size();
  }

 private:
  std::optional<T> TakeFront() {
    if (items_.empty()) return std::nullopt;
    std::optional<T> item(std::move(items_.front()));
    items_.pop_front();
    space_.notify_one();
    return item;
  }

  const size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable space_, filled_;
  std::deque<T> items_;
  bool closed_ = false;
};

}  // namespace stratalux::rig
