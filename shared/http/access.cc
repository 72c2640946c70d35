// SPDX-License-Identifier: Apache-2.0
#include "shared/http/access.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <utility>

#include <arpa/inet.h>
#include <fcntl.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include "shared/http/target.h"

namespace stratalux::http {
namespace {

constexpr size_t kMostPeers = 256;  // whose wrong tokens are remembered

std::string Lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](char c) { return static_cast<char>(std::tolower(static_cast<unsigned char>(c))); });
  return text;
}

// "127.0.0.1:8080" and "[::1]:8080" without the port, and whether the port is `port`; nullopt where it is no number.
std::optional<std::pair<std::string, bool>> HostOf(const std::string& authority, int port) {
  std::string host = Lower(authority), tail;
  const size_t bracket = host.rfind(']');
  const size_t colon = host.find(':', bracket == std::string::npos ? 0 : bracket);
  if (colon != std::string::npos) {
    tail = host.substr(colon + 1);
    host.resize(colon);
  }
  if (tail.find_first_not_of("0123456789") != std::string::npos) return std::nullopt;
  return std::pair{host, tail == std::to_string(port) || (tail.empty() && port == 80)};
}

bool IsAddress(const std::string& host) {
  std::array<unsigned char, 16> bytes{};
  if (inet_pton(AF_INET, host.c_str(), bytes.data()) == 1) return true;
  const bool bracketed = host.size() > 2 && host.front() == '[' && host.back() == ']';
  return bracketed && inet_pton(AF_INET6, host.substr(1, host.size() - 2).c_str(), bytes.data()) == 1;
}

bool Reads(const Request& request) { return request.method == Method::kGet || request.method == Method::kHead; }

// Of a keeper's session (access.h).
BrowserSessions::Counts CountsFor(const Request& request, Audience audience) {
  const bool by_hand = !Reads(request) || !request.Header("stratalux-touched").empty();
  return audience == Audience::kKeepers && by_hand ? BrowserSessions::Counts::kAsUse : BrowserSessions::Counts::kNot;
}

std::string WithoutToken(const Request& request) {
  std::string place, separator = "?";
  for (size_t at = 0; at < request.path.size(); ++at)
    place += request.path[at] == '/' ? "/" : PercentEncode(request.path.substr(at, 1));
  for (const auto& [name, value] : request.query) {
    if (name == "token") continue;
    place += separator + PercentEncode(name) + "=" + PercentEncode(value);
    separator = "&";
  }
  return place;
}

}  // namespace

bool SameSecret(std::string_view given, std::string_view secret) {
  if (secret.empty()) return false;
  // The length of what was given is known to who gave it; the secret's own must not show.
  volatile unsigned char difference = given.size() == secret.size() ? 0 : 1;
  for (size_t i = 0; i < given.size(); ++i)
    difference = static_cast<unsigned char>(difference | (given[i] ^ secret[i % secret.size()]));
  return difference == 0;
}

Result<std::string> RandomToken() {
  std::array<unsigned char, 32> bytes{};
  if (getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size()))
    return Status::Failed(std::string("no random bytes: ") + std::strerror(errno));
  std::string token;
  char pair[3];
  for (const unsigned char byte : bytes) {
    std::snprintf(pair, sizeof pair, "%02x", byte);
    token += pair;
  }
  return token;
}

Result<std::string> ReadTokenFile(const std::string& file) {
  const UniqueFd fd(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  struct stat facts {};
  if (!fd.ok() || fstat(fd.get(), &facts) != 0)
    return Status::Usage("token file " + file + ": " + std::strerror(errno) +
                         "; make one: (umask 077; openssl rand -hex 32 > " + file + ")");
  if (!S_ISREG(facts.st_mode)) return Status::Usage("token file " + file + " is not a regular file");
  if ((facts.st_mode & 077) != 0)
    return Status::Usage("token file " + file + " can be read by others; chmod 600 " + file);
  char text[513];
  const ssize_t bytes = read(fd.get(), text, sizeof text);
  if (bytes < 0) return Status::Usage("token file " + file + ": " + std::strerror(errno));
  std::string token(text, static_cast<size_t>(bytes));
  token.resize(std::min(token.find_first_of("\r\n"), token.size()));
  const bool plain = std::all_of(token.begin(), token.end(), [](char c) { return c > 0x20 && c < 0x7f; });
  if (token.size() < 16 || token.size() > 512 || !plain)
    return Status::Usage("token file " + file +
                         ": its first line must be 16 to 512 printable characters without blanks;"
                         " make one: (umask 077; openssl rand -hex 32 > " +
                         file + ")");
  return token;
}

AccessGuard::AccessGuard(AccessOptions options, int port)
    : options_(std::move(options)),
      port_(port),
      // A browser does not keep cookies apart by port.
      visitors_("stratalux_" + std::to_string(port), std::chrono::seconds(0), options_.now),
      keepers_("stratalux_keeper_" + std::to_string(port), options_.keeper_idle, options_.now) {
  for (std::string& name : options_.host_names) name = Lower(name);
}

std::optional<Response> AccessGuard::CheckHost(const Request& request) const {
  const auto found = request.headers.find("host");
  if (found == request.headers.end()) return Response::Text(400, "the request names no host");
  const auto named = HostOf(found->second, port_);
  const std::string host = named ? named->first : "";
  if (named && named->second && (host == "localhost" || IsAddress(host))) return std::nullopt;
  // By whatever port: that of a proxy in front is its own, and what must not be rebound is the name.
  const auto& names = options_.host_names;
  if (std::find(names.begin(), names.end(), host) != names.end()) return std::nullopt;
  return Response::Text(421, "this server is not known by that name");
}

std::optional<Response> AccessGuard::CheckOrigin(const Request& request) const {
  if (Reads(request)) return std::nullopt;
  if (HasBearer(request, Audience::kHoldersOfToken)) return std::nullopt;
  const std::string origin = request.Header("origin"), site = request.Header("sec-fetch-site");
  const std::string host = Lower(request.Header("host"));
  const bool ours = Lower(origin) == "http://" + host || Lower(origin) == "https://" + host;
  if (!site.empty() && site != "same-origin")
    return Response::Text(403, "only this server's own pages may ask for this");
  if (ours || (origin.empty() && site == "same-origin")) return std::nullopt;
  return Response::Text(403, "only this server's own pages may ask for this");
}

bool AccessGuard::HasBearer(const Request& request, Audience audience) const {
  const std::string header = request.Header("authorization");
  if (Lower(header.substr(0, 7)) != "bearer ") return false;
  const std::string_view given = std::string_view(header).substr(7);
  return SameSecret(given, options_.keeper_token) ||
         (audience != Audience::kKeepers && SameSecret(given, options_.token));
}

bool AccessGuard::TooManyWrong(const std::string& peer) {
  const std::lock_guard lock(mutex_);
  const auto found = wrong_.find(peer);
  if (found == wrong_.end()) return false;
  auto& moments = found->second;
  while (!moments.empty() && options_.now() - moments.front() > std::chrono::minutes(1)) moments.pop_front();
  if (moments.empty()) wrong_.erase(found);
  return static_cast<int>(wrong_.count(peer) != 0 ? wrong_[peer].size() : 0) >= options_.wrong_tokens_per_minute;
}

void AccessGuard::NoteWrong(const std::string& peer) {
  const std::lock_guard lock(mutex_);
  if (wrong_.size() >= kMostPeers && wrong_.count(peer) == 0) wrong_.erase(wrong_.begin());
  wrong_[peer].push_back(options_.now());
}

Response AccessGuard::Enter(const Request& request) {
  {
    const std::lock_guard lock(mutex_);
    if (options_.link_use == LinkUse::kOnce && std::exchange(link_used_, true))
      return Response::Text(401, "this link was used already; restart the server for a new one");
  }
  const auto cookie = visitors_.Begin();
  if (!cookie.ok()) return Response::Text(500, cookie.status().message());
  Response response = Response::SeeOther(WithoutToken(request));
  return std::move(response.With("Set-Cookie", *cookie));
}

std::optional<Response> AccessGuard::CheckSignIn(const Request& request) {
  if (options_.sign_in.empty() || request.path != options_.sign_in) return std::nullopt;
  Response response;
  response.status = 204;
  if (request.method == Method::kDelete) {
    if (auto refusal = CheckOrigin(request)) return refusal;
    return std::move(response.With("Set-Cookie", keepers_.End(request)));
  }
  if (request.method != Method::kPost) return std::nullopt;
  if (TooManyWrong(request.peer)) return Response::Text(429, "too many wrong tokens; wait a minute");
  if (!HasBearer(request, Audience::kKeepers)) {
    NoteWrong(request.peer);
    Response refusal = Response::Text(401, "that is not the token of this program");
    return std::move(refusal.With("WWW-Authenticate", "Bearer"));
  }
  const auto cookie = keepers_.Begin();
  if (!cookie.ok()) return Response::Text(500, cookie.status().message());
  return std::move(response.With("Set-Cookie", *cookie));
}

std::optional<Response> AccessGuard::CheckToken(const Request& request, Audience audience) {
  if (audience == Audience::kEverybody) return std::nullopt;
  if (audience == Audience::kHoldersOfToken && options_.token.empty()) return std::nullopt;
  const auto given = request.query.find("token");
  if (keepers_.Has(request, CountsFor(request, audience))) return std::nullopt;
  if (audience == Audience::kHoldersOfToken && visitors_.Has(request, BrowserSessions::Counts::kAsUse))
    return given == request.query.end() ? std::nullopt : std::optional(Response::SeeOther(WithoutToken(request)));
  const bool tries = given != request.query.end() || request.headers.count("authorization") != 0;
  if (tries && TooManyWrong(request.peer)) return Response::Text(429, "too many wrong tokens; wait a minute");
  if (HasBearer(request, audience)) return std::nullopt;
  if (audience == Audience::kHoldersOfToken && Reads(request) && given != request.query.end() &&
      SameSecret(given->second, options_.token)) {
    // Programs that look at links before people do (HEAD) must not use them up.
    if (request.method == Method::kHead) return Response::SeeOther(WithoutToken(request));
    return Enter(request);
  }
  if (tries) NoteWrong(request.peer);
  Response refusal =
      Response::Text(401, audience == Audience::kKeepers ? "only whoever runs this place may see this: sign in"
                                                         : "open the link that the program printed when it started");
  return std::move(refusal.With("WWW-Authenticate", "Bearer"));
}

}  // namespace stratalux::http
