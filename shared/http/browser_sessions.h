// SPDX-License-Identifier: Apache-2.0
// Browsers that have shown a token once and are known by a cookie since.
#pragma once

#include <chrono>
#include <deque>
#include <functional>
#include <mutex>
#include <string>
#include <utility>

#include "shared/base/result.h"
#include "shared/http/message.h"

namespace stratalux::http {

// Thread-safe. At most 32 browsers; the oldest must show the token again.
class BrowserSessions {
 public:
  // Whether a request holds its session for longer: a page that asks by itself every few seconds must not.
  enum class Counts { kAsUse, kNot };
  using Clock = std::function<std::chrono::steady_clock::time_point()>;
  // `idle`: a session that was not used for longer ends; zero: none does.
  BrowserSessions(std::string cookie, std::chrono::seconds idle, Clock now)
      : cookie_(std::move(cookie)), idle_(idle), now_(std::move(now)) {}

  // Whether the request's cookie is one of ours.
  [[nodiscard]] bool Has(const Request& request, Counts counts);
  // A new one: the value of a Set-Cookie header (HttpOnly, SameSite=Strict, until the browser is closed).
  [[nodiscard]] Result<std::string> Begin();
  // The request's own ends; the value of a Set-Cookie header that takes the cookie back.
  [[nodiscard]] std::string End(const Request& request);

 private:
  struct Session {
    std::string secret;
    std::chrono::steady_clock::time_point used;
  };

  std::string cookie_;
  std::chrono::seconds idle_;
  Clock now_;
  std::mutex mutex_;
  std::deque<Session> sessions_;
};

}  // namespace stratalux::http
