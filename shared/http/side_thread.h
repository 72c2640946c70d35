// SPDX-License-Identifier: Apache-2.0
// SideThread: one thread for what would hold up those of the server.
#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>

namespace stratalux::http {

// Thread-safe; pieces are done one after another, in order.
class SideThread {
 public:
  // `stopping`: the piece is not to be done any more, only ended.
  using Piece = std::function<void(bool stopping)>;
  explicit SideThread(size_t most_waiting) : most_waiting_(most_waiting) {}
  ~SideThread() { Stop(); }
  SideThread(const SideThread&) = delete;
  SideThread& operator=(const SideThread&) = delete;

  // False, and `piece` is dropped, where too many wait behind another, where the system gives no thread, and after
  // Stop(). The thread starts with the first one; a piece throws nothing.
  // `before` runs where the piece is taken, before the thread can begin with it.
  bool Add(Piece piece, const std::function<void()>& before);
  // Waits for the piece that runs, ends those that wait.
  void Stop();

 private:
  void Run();

  const size_t most_waiting_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Piece> waiting_;
  bool stopping_ = false, runs_ = false;
  std::thread thread_;
};

}  // namespace stratalux::http
