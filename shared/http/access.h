// SPDX-License-Identifier: Apache-2.0
// Who may ask, and from which page: names of the host, origins, tokens, sessions of a browser.
#pragma once

#include <chrono>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "shared/base/result.h"
#include "shared/http/browser_sessions.h"
#include "shared/http/message.h"

namespace stratalux::http {

// Takes as long for the first wrong character as for the last.
[[nodiscard]] bool SameSecret(std::string_view given, std::string_view secret);
// 256 bits of the system's chance as 64 hex digits.
[[nodiscard]] Result<std::string> RandomToken();
// The first line of a file that others cannot read (mode 0600 or stricter), at least 16 characters without blanks.
// kUsage otherwise, with the remedy.
[[nodiscard]] Result<std::string> ReadTokenFile(const std::string& file);

// Who may ask: a route is for holders of the token unless it says that it is open (a style sheet, a health check), or
// for those who run the place alone.
enum class Audience { kHoldersOfToken, kEverybody, kKeepers };

// A link with ?token= gives a browser its session: printed links work once, so that none in a history or a log opens
// anything; a token out of a file is given to several people.
enum class LinkUse { kOnce, kAlways };

struct AccessOptions {
  std::string token;  // empty: everybody may ask, but for what is the keepers'
  LinkUse link_use = LinkUse::kOnce;
  std::vector<std::string> host_names = {};  // beside localhost and addresses, which no foreign name can stand for
  int wrong_tokens_per_minute = 20;          // of one peer; then 429
  // Of those who run the place (Audience::kKeepers); it opens all that `token` does. Empty: nobody is one.
  std::string keeper_token = {};
  // Where a keeper's browser gets its session: POST there with the keepers' token as bearer, DELETE ends it. Empty:
  // nowhere.
  std::string sign_in = {};
  // After which without a use a keeper's session ends. Uses are requests for what is the keepers' alone: orders (all
  // but GET and HEAD), and others with the header `Stratalux-Touched`, which a page sends after a key or a pointer was
  // pressed. What a page asks by itself is none, nor is what a visitor presses in the same browser.
  std::chrono::minutes keeper_idle{30};
  std::function<std::chrono::steady_clock::time_point()> now = std::chrono::steady_clock::now;
};

// Thread-safe.
class AccessGuard {
 public:
  AccessGuard(AccessOptions options, int port);

  // Refusals in the order in which they are looked for; nullopt: the request may pass.
  // 421: the Host header names none of ours, so that a foreign name that was made to point here (DNS rebinding) reads
  // nothing.
  [[nodiscard]] std::optional<Response> CheckHost(const Request& request) const;
  // 403: a POST, PUT or DELETE that does not come from a page of ours (Origin, Sec-Fetch-Site) nor carries the token.
  [[nodiscard]] std::optional<Response> CheckOrigin(const Request& request) const;
  // 401 without `Authorization: Bearer TOKEN` or a session that opens what is for `audience`; 429. A right ?token= is
  // answered by 303 to the same path without it, with the session's cookie. Keepers have no such links: what is in an
  // address is in histories and logs.
  [[nodiscard]] std::optional<Response> CheckToken(const Request& request, Audience audience);
  // The answer to a POST (204 with the session's cookie, 401, 429) or DELETE (204) of the place to sign in; nullopt for
  // all else.
  [[nodiscard]] std::optional<Response> CheckSignIn(const Request& request);

 private:
  [[nodiscard]] bool HasBearer(const Request& request, Audience audience) const;
  [[nodiscard]] bool TooManyWrong(const std::string& peer);
  void NoteWrong(const std::string& peer);
  [[nodiscard]] Response Enter(const Request& request);

  AccessOptions options_;
  int port_;
  BrowserSessions visitors_, keepers_;
  std::mutex mutex_;
  bool link_used_ = false;
  std::map<std::string, std::deque<std::chrono::steady_clock::time_point>> wrong_;
};

}  // namespace stratalux::http
