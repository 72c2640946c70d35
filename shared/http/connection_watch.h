// SPDX-License-Identifier: Apache-2.0
// Ends connections that take too long over one thing. The library's own limit counts from the last byte, so that a byte
// now and then would hold a connection for ever.
#pragma once

#include <chrono>
#include <map>
#include <mutex>

namespace stratalux::http {

// Thread-safe. A connection is known by any pointer that is its own.
class ConnectionWatch {
 public:
  using Clock = std::chrono::steady_clock;
  ConnectionWatch(std::chrono::seconds request, std::chrono::seconds answer) : request_(request), answer_(answer) {}

  void Opened(const void* connection, int socket);
  // Before its socket is closed.
  void Closed(const void* connection);
  void Reads(const void* connection);    // a request, from now on
  void Answers(const void* connection);  // from now on
  void Streams(const void* connection);  // for as long as it likes
  // Shuts down what is late; the library then notices and closes.
  void EndLate(Clock::time_point now);

 private:
  struct Entry {
    int socket = -1;
    Clock::time_point deadline;
  };
  void Set(const void* connection, Clock::time_point deadline);

  std::chrono::seconds request_, answer_;
  std::mutex mutex_;
  std::map<const void*, Entry> connections_;
};

}  // namespace stratalux::http
