// SPDX-License-Identifier: Apache-2.0
#include "shared/http/connection_watch.h"

#include <sys/socket.h>

namespace stratalux::http {

void ConnectionWatch::Opened(const void* connection, int socket) {
  const std::lock_guard lock(mutex_);
  connections_[connection] = {socket, Clock::now() + request_};
}

void ConnectionWatch::Closed(const void* connection) {
  const std::lock_guard lock(mutex_);
  connections_.erase(connection);
}

void ConnectionWatch::Set(const void* connection, Clock::time_point deadline) {
  const std::lock_guard lock(mutex_);
  if (const auto found = connections_.find(connection); found != connections_.end()) found->second.deadline = deadline;
}

void ConnectionWatch::Reads(const void* connection) { Set(connection, Clock::now() + request_); }
void ConnectionWatch::Answers(const void* connection) { Set(connection, Clock::now() + answer_); }
void ConnectionWatch::Streams(const void* connection) { Set(connection, Clock::time_point::max()); }

void ConnectionWatch::EndLate(Clock::time_point now) {
  // Under the lock: a socket that was closed may be somebody else's by now.
  const std::lock_guard lock(mutex_);
  for (auto& [connection, entry] : connections_) {
    if (now < entry.deadline) continue;
    shutdown(entry.socket, SHUT_RDWR);
    entry.deadline = Clock::time_point::max();
  }
}

}  // namespace stratalux::http
