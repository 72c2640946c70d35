// SPDX-License-Identifier: Apache-2.0
// A small HTTP/1.1 server for pages that one or a few people look at: the store's, the kiosk's. No TLS: loopback, or a
// reverse proxy in front.
//
// Each request passes in this order: size of its header (431) and body (413), form of its target (400), Host (421),
// signing in, route (404, 405 with Allow), token (401, 429), origin (403), handler. A handler that throws is answered
// by 500 and told in the log. Slow answers (message.h) are made one after another on a thread of their own, while the
// server's threads serve others; of those that wait already one too many is answered by 503. Every answer carries
// Content-Security-Policy (own files alone, nothing inline, in no frame), X-Content-Type-Options, Referrer-Policy,
// Cross-Origin-Resource-Policy and Cache-Control: no-store; but what is no HTTP, or overflows all that is read of a
// header, is answered by the library alone, before any of this is known.
#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/http/access.h"
#include "shared/http/router.h"

namespace stratalux::http {

struct ServerLimits {
  size_t header_bytes = 8 << 10;  // request line and headers
  size_t body_bytes = 4 << 10;
  int connections = 64;
  int connections_per_peer = 32;  // a browser opens six
  // Without a byte, and for a whole request however slowly its bytes come.
  std::chrono::seconds idle{10};
  std::chrono::seconds answer{300};              // for a whole answer, but a stream of events
  std::chrono::milliseconds keep_alive{15'000};  // comments in a stream of events
  int slow_answers = 4;                          // that wait while another is made
};

struct ServerOptions {
  std::string address = "127.0.0.1";  // IPv4 or IPv6, without brackets
  int port = 0;                       // 0: any free one
  int threads = 1;                    // more than one: handlers run beside each other
  ServerLimits limits = {};
  AccessOptions access = {};
  [[nodiscard]] Status Validate() const;
};

// 127.0.0.0/8 or ::1.
[[nodiscard]] bool IsLoopback(const std::string& address);

class Server {
 public:
  // kUsage: the options; kBusy: the port is taken; kFailed: this machine has no such address. `router` and `logger` are
  // kept as long as the server.
  static Result<Server> Start(ServerOptions options, Router router, Logger& logger);
  // Stop().
  ~Server();
  Server(Server&&) noexcept;
  Server& operator=(Server&&) noexcept;

  [[nodiscard]] int port() const;
  [[nodiscard]] std::string url() const;  // "http://127.0.0.1:8080", "http://[::1]:8080"
  // Connections that are open.
  [[nodiscard]] int connections() const;
  // Ends streams and connections, waits for handlers and the slow answer that run, begins none that waits, joins the
  // server's threads.
  void Stop();

 private:
  struct Impl;
  explicit Server(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace stratalux::http
