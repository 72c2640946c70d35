// SPDX-License-Identifier: Apache-2.0
#include "shared/http/browser_sessions.h"

#include <algorithm>

#include "shared/http/access.h"

namespace stratalux::http {
namespace {

constexpr size_t kMostSessions = 32;
constexpr const char* kAttributes = "; Path=/; HttpOnly; SameSite=Strict";

// The value of a cookie, "" without it.
std::string Cookie(const std::string& header, const std::string& name) {
  for (size_t at = 0; at < header.size();) {
    at = std::min(header.find_first_not_of(" ;,", at), header.size());
    const size_t end = std::min(header.find_first_of(";,", at), header.size());
    const std::string pair = header.substr(at, end - at);
    if (pair.starts_with(name + "=")) return pair.substr(name.size() + 1);
    at = end;
  }
  return "";
}

}  // namespace

bool BrowserSessions::Has(const Request& request, Counts counts) {
  const std::string given = Cookie(request.Header("cookie"), cookie_);
  if (given.empty()) return false;
  const std::lock_guard lock(mutex_);
  const auto now = now_();
  if (idle_.count() > 0) std::erase_if(sessions_, [&](const Session& session) { return now - session.used > idle_; });
  Session* known = nullptr;
  for (Session& session : sessions_)
    if (SameSecret(given, session.secret)) known = &session;
  if (known != nullptr && counts == Counts::kAsUse) known->used = now;
  return known != nullptr;
}

Result<std::string> BrowserSessions::Begin() {
  SLX_ASSIGN_OR_RETURN(std::string secret, RandomToken());
  const std::lock_guard lock(mutex_);
  if (sessions_.size() >= kMostSessions) sessions_.pop_front();
  sessions_.push_back({secret, now_()});
  return cookie_ + "=" + secret + kAttributes;
}

std::string BrowserSessions::End(const Request& request) {
  const std::string given = Cookie(request.Header("cookie"), cookie_);
  const std::lock_guard lock(mutex_);
  std::erase_if(sessions_, [&given](const Session& session) { return SameSecret(given, session.secret); });
  return cookie_ + "=" + kAttributes + "; Max-Age=0";
}

}  // namespace stratalux::http
