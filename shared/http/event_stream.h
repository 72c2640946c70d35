// SPDX-License-Identifier: Apache-2.0
// One stream of server-sent events, shared by all who look on (WHATWG HTML, "Server-sent events").
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>

namespace stratalux::http {

struct EventStreamOptions {
  size_t kept_bytes = 64 << 10;    // of events, for those who come back and say which they saw last
  size_t viewer_bytes = 64 << 10;  // waiting for one viewer; one who is slower than that is dropped
};

// Thread-safe. Events are numbered from 1 in each run. Whoever comes gets the last event, so that a page shows how
// things stand; one who comes back with Last-Event-ID also gets what came between, as far as it is kept. The last one
// comes even where it is the one seen: it tells the page that the program is there again, and a number equal to it may
// be another run's.
class EventStream {
 public:
  explicit EventStream(EventStreamOptions options = {}) : options_(options) {}

  // `name` is one word; `data` may have several lines.
  void Publish(const std::string& name, const std::string& data);
  // A comment to everybody, which finds out who is gone.
  void KeepAlive();
  // Every viewer's stream ends.
  void Close();
  [[nodiscard]] size_t viewers() const;

  // The server's side. `wake` is called with the stream's lock held, at most once for each Wait() that answered kWait;
  // never after Remove().
  int64_t Add(const std::string& last_event_id, std::function<void()> wake);
  void Remove(int64_t viewer);
  struct Taken {
    enum class State { kBytes, kWait, kEnd } state;
    size_t bytes = 0;
  };
  // `before_wait` runs under the lock where there is nothing to give, so that no wake-up comes too early.
  Taken Take(int64_t viewer, std::span<char> buffer, const std::function<void()>& before_wait);

 private:
  struct Viewer {
    std::function<void()> wake;
    std::string waiting;
    bool asleep = false, dropped = false;
  };
  void Give(Viewer& viewer, const std::string& text);
  static void Wake(Viewer& viewer);

  EventStreamOptions options_;
  mutable std::mutex mutex_;
  bool closed_ = false;
  int64_t next_event_ = 1, next_viewer_ = 1;
  std::deque<std::pair<int64_t, std::string>> kept_;
  size_t kept_bytes_ = 0;
  std::map<int64_t, Viewer> viewers_;
};

}  // namespace stratalux::http
